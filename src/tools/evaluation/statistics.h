#pragma once

#include <cstddef>
#include <vector>

namespace semantic_topo_loop::core {

struct ErrorStatistics {
  std::size_t count = 0;
  double rmse = 0.0, mean = 0.0, median = 0.0, max = 0.0;
};

/// All zero for no errors.
ErrorStatistics error_statistics(std::vector<double> errors);

/// A count of right ones among those that were looked at.
struct Ratio {
  int right = 0, total = 0;
  double value() const { return total > 0 ? static_cast<double>(right) / total : 0.0; }
};

}  // namespace semantic_topo_loop::core
