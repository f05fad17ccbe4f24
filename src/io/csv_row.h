#pragma once

#include <cstdint>
#include <string>

#include "semantic_topo_loop/io/text_file.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// One row of a CSV file, built field by field.
class CsvRow {
 public:
  CsvRow& add(const std::string& text) {
    row_ += (row_.empty() ? "" : ",") + text;
    return *this;
  }
  CsvRow& add(std::int64_t number) { return add(std::to_string(number)); }
  CsvRow& add(double number, int decimals) { return add(format_fixed(number, decimals)); }
  CsvRow& add(const Vec3& v) {
    return add(v.x(), kLengthDecimals).add(v.y(), kLengthDecimals).add(v.z(), kLengthDecimals);
  }
  CsvRow& add(const Quaternion& q) {
    return add(q.x(), kLengthDecimals)
        .add(q.y(), kLengthDecimals)
        .add(q.z(), kLengthDecimals)
        .add(q.w(), kLengthDecimals);
  }
  CsvRow& add(const SE3& T) { return add(T.t).add(T.q); }
  std::string end() const { return row_ + '\n'; }

 private:
  static constexpr int kLengthDecimals = 9;
  std::string row_;
};

}  // namespace semantic_topo_loop::core
