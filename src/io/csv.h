#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <type_traits>
#include <vector>

#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/types/result.h"
#include "semantic_topo_loop/types/stamp.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// A CSV file with a header and no quoting. What reads a field of the current row notes the first failure, with file,
/// line, column and value, and gives zero, so that a row is read in one go and checked once.
class CsvTable {
 public:
  /// @return an error, with file and line, for a missing or empty file or a row of another width
  static Result<CsvTable> read(const std::string& path);

  std::size_t size() const { return rows_.size(); }
  void select(std::size_t row) { row_ = row; }
  /// @param names of a field's columns, joined by commas
  bool has(const std::string& names) const { return columns_.count(names.substr(0, names.find(','))) != 0; }
  double number(const std::string& column);
  std::int64_t integer(const std::string& column);
  std::string text(const std::string& column);
  /// Notes a failure of the current row that the caller found.
  void reject(const std::string& column, const std::string& rule);
  /// Empty if nothing failed so far.
  const std::string& error() const { return error_; }

  // As a visitor of columns, see below.
  void operator()(const char* name, bool& flag);
  void operator()(const char* name, int& number);
  void operator()(const char* name, std::int64_t& value) { value = integer(name); }
  void operator()(const char* name, double& value) { value = number(name); }
  void operator()(const char* name, std::string& value) { value = text(name); }
  void operator()(const char* names, Vec3& vector);
  void operator()(const char* names, Quaternion& rotation);
  template <class Field>
  void optional(const char* names, Field& field) {
    if (has(names)) (*this)(names, field);
  }
  template <class Field>
  void written(const char*, const Field&) {}
  void stamp(const char* name, std::int64_t& stamp_ns);

 private:
  struct Row {
    int line = 0;
    std::vector<std::string> fields;
  };

  std::string path_;
  std::map<std::string, std::size_t> columns_;
  std::vector<Row> rows_;
  std::size_t row_ = 0;
  std::string error_;
};

/// Reads every row through `read_row`; the first failure of any becomes the error.
template <class Row, class ReadRow>
Result<std::vector<Row>> read_csv(const std::string& path, const ReadRow& read_row) {
  Result<CsvTable> table = CsvTable::read(path);
  if (!table) return table.error();
  std::vector<Row> rows;
  for (std::size_t i = 0; i < table->size(); ++i) {
    table->select(i);
    rows.push_back(read_row(*table));
    if (!table->error().empty()) return Error{table->error()};
  }
  return rows;
}

/// A field as CSV files have it: lengths and rotations with 9 decimals, other numbers with 6, flags as 0 and 1. Numbers
/// with other decimals are given as texts.
inline std::string csv_field(const std::string& text) { return text; }
inline std::string csv_field(double number) { return format_fixed(number, 6); }
template <class Integer, class = std::enable_if_t<std::is_integral_v<Integer>>>
std::string csv_field(Integer number) {
  return std::to_string(number);
}
template <int rows>
std::string csv_field(const Eigen::Matrix<double, rows, 1>& v) {
  std::string text;
  for (int i = 0; i < rows; ++i) text += (i == 0 ? "" : ",") + format_fixed(v[i], 9);
  return text;
}
inline std::string csv_field(const Quaternion& q) { return csv_field(q.coeffs()); }

template <class... Fields>
std::string csv_row(const Fields&... fields) {
  std::string row;
  ((row += (row.empty() ? "" : ",") + csv_field(fields)), ...);
  return row + '\n';
}

// The columns of a file are listed once, by a function `visit_columns(row, visitor)` that shows each field with the
// name of its column. The visitors are CsvWriter, which writes a row or the first line, and CsvTable, which reads one.

/// Writes a row; stamps in seconds.
class CsvWriter {
 public:
  /// @param is_header writes the names of the columns in place of the fields
  explicit CsvWriter(bool is_header = false) : is_header_(is_header) {}
  /// @param names of a field's columns, joined by commas
  template <class Field>
  void operator()(const char* names, const Field& field) {
    row_ += (row_.empty() ? "" : ",") + (is_header_ ? std::string(names) : csv_field(field));
  }
  /// For columns that a file need not have to be read.
  template <class Field>
  void optional(const char* names, const Field& field) {
    (*this)(names, field);
  }
  /// For columns that are not read.
  template <class Field>
  void written(const char* names, const Field& field) {
    (*this)(names, field);
  }
  void stamp(const char* name, std::int64_t stamp_ns) { (*this)(name, format_stamp(stamp_ns)); }
  std::string end() const { return row_ + '\n'; }

 private:
  bool is_header_;
  std::string row_;
};

}  // namespace semantic_topo_loop::core
