#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace semantic_topo_loop::core {

// Numbers have a decimal point here, whatever the locale of the process.

/// A line of a text file, without its line end.
struct TextLine {
  int number = 0;  ///< from 1
  std::string_view text;
};

/// Every line that is neither blank nor a `#` comment. The views point into `text`.
std::vector<TextLine> content_lines(std::string_view text);

/// The fields of a line: separated by blanks and tabs, or by `separator` (empty fields are kept then).
std::vector<std::string_view> split_blanks(std::string_view line);
std::vector<std::string_view> split(std::string_view line, char separator);

/// The whole text as a number ("nan" and "inf" are numbers), or nullopt.
std::optional<double> parse_double(std::string_view text);
std::optional<std::int64_t> parse_integer(std::string_view text);

/// `<path>:<line>: <message>`.
std::string at_line(const std::string& path, int line, const std::string& message);

/// printf's %.*f and %.*g.
std::string format_fixed(double value, int decimals);
std::string format_general(double value, int digits);

}  // namespace semantic_topo_loop::core
