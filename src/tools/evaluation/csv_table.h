#pragma once

#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "semantic_topo_loop/types/eigen.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// A CSV file with a header and no quoting. Getters of the current row note the first failure, with file, line, column
/// and value, and give zero, so that a row is read in one go and checked once.
class CsvTable {
 public:
  /// @return an error, with file and line, for a missing or empty file or a row of another width
  static Result<CsvTable> read(const std::string& path);

  std::size_t size() const { return rows_.size(); }
  void select(std::size_t row) { row_ = row; }
  bool has(const std::string& column) const { return columns_.count(column) != 0; }
  double number(const std::string& column);
  std::int64_t integer(const std::string& column);
  std::int64_t stamp_ns(const std::string& column);
  std::string text(const std::string& column);
  Vec3 vector(const std::string& x, const std::string& y, const std::string& z);
  /// Notes a failure of the current row that the caller found.
  void reject(const std::string& column, const std::string& rule);
  /// Empty if nothing failed so far.
  const std::string& error() const { return error_; }

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

}  // namespace semantic_topo_loop::core
