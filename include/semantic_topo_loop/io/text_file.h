#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <ostream>
#include <string>
#include <string_view>
#include <vector>

namespace semantic_topo_loop::core {

/// @return nullopt, with path and cause in `error`, if the file is missing, a directory or unreadable
std::optional<std::string> read_text_file(const std::string& path, std::string* error);

/// Writes a temporary file beside `path` and renames it, so that a reader never sees half a file.
bool write_text_file(const std::string& path, const std::string& text, std::string* error);
/// The same with what `write` gives to the stream, for files that are better not held in memory as a whole.
bool write_file(const std::string& path, const std::function<void(std::ostream&)>& write, std::string* error);

/// @return false, with path and cause in `error`, if the directory neither exists nor can be made
bool make_directory(const std::string& path, std::string* error);

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
