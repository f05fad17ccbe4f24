#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <ostream>
#include <string>
#include <string_view>
#include <vector>

#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// Every error names the path and the cause.
Result<std::string> read_text_file(const std::string& path);

/// Writes a temporary file beside `path` and renames it, so that a reader never sees half a file.
Status write_text_file(const std::string& path, const std::string& text);
/// The same with what `write` gives to the stream, for files that are better not held in memory as a whole.
Status write_file(const std::string& path, const std::function<void(std::ostream&)>& write);

/// Succeeds if the directory is there already.
Status make_directory(const std::string& path);

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
