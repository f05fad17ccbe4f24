#include "io/csv.h"

#include <array>
#include <cmath>

namespace semantic_topo_loop::core {

Result<CsvTable> CsvTable::read(const std::string& path) {
  const Result<std::string> text = read_text_file(path);
  if (!text) return text.error();
  const std::vector<TextLine> lines = content_lines(*text);
  if (lines.empty()) return Error{path + ": the file is empty"};
  CsvTable table;
  table.path_ = path;
  for (const std::string_view name : split(lines.front().text, ',')) {
    const std::size_t column = table.columns_.size();
    if (table.columns_.emplace(name, column).second) continue;
    return Error{at_line(path, lines.front().number, "column '" + std::string(name) + "' is there twice")};
  }
  for (std::size_t i = 1; i < lines.size(); ++i) {
    const std::vector<std::string_view> fields = split(lines[i].text, ',');
    if (fields.size() != table.columns_.size()) {
      return Error{
          at_line(path, lines[i].number,
                  std::to_string(fields.size()) + " fields instead of " + std::to_string(table.columns_.size()))};
    }
    table.rows_.push_back({lines[i].number, std::vector<std::string>(fields.begin(), fields.end())});
  }
  return table;
}

std::string CsvTable::text(const std::string& column) {
  const auto it = columns_.find(column);
  if (it != columns_.end()) return rows_[row_].fields[it->second];
  if (error_.empty()) error_ = path_ + ": column '" + column + "' is missing";
  return {};
}

void CsvTable::reject(const std::string& column, const std::string& rule) {
  const std::string value = text(column);
  if (error_.empty()) error_ = at_line(path_, rows_[row_].line, column + " = '" + value + "' " + rule);
}

double CsvTable::number(const std::string& column) {
  const std::optional<double> value = parse_double(text(column));
  if (value && std::isfinite(*value)) return *value;
  reject(column, "is no finite number");
  return 0.0;
}

std::int64_t CsvTable::integer(const std::string& column) {
  const std::optional<std::int64_t> value = parse_integer(text(column));
  if (!value) reject(column, "is no integer");
  return value.value_or(0);
}

void CsvTable::stamp(const char* name, std::int64_t& stamp_ns) {
  const std::optional<std::int64_t> value = parse_stamp(text(name));
  if (!value) reject(name, "is no stamp in seconds");
  stamp_ns = value.value_or(0);
}

void CsvTable::operator()(const char* name, int& number) {
  const std::int64_t value = integer(name);
  if (value != static_cast<int>(value)) reject(name, "is no integer of 32 bits");
  number = static_cast<int>(value);
}

void CsvTable::operator()(const char* name, bool& flag) {
  const std::int64_t value = integer(name);
  flag = value == 1;
  if (value != 0 && value != 1) reject(name, "must be 0 or 1");
}

void CsvTable::operator()(const char* names, Vec3& vector) {
  const std::vector<std::string_view> n = split(names, ',');
  for (std::size_t i = 0; i < n.size(); ++i) vector[static_cast<int>(i)] = number(std::string(n[i]));
}

void CsvTable::operator()(const char* names, Quaternion& rotation) {
  const std::vector<std::string_view> n = split(names, ',');
  std::array<double, 4> v{};
  for (std::size_t i = 0; i < v.size(); ++i) v[i] = number(std::string(n[i]));
  const Quaternion q(v[3], v[0], v[1], v[2]);
  if (!is_rotation(q)) reject(std::string(n[3]), "is part of a quaternion that is no rotation");
  rotation = q.normalized();
}

}  // namespace semantic_topo_loop::core
