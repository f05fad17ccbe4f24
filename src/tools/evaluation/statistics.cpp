#include "tools/evaluation/statistics.h"

#include <algorithm>
#include <cmath>

namespace semantic_topo_loop::core {

ErrorStatistics error_statistics(std::vector<double> errors) {
  ErrorStatistics statistics;
  statistics.count = errors.size();
  if (errors.empty()) return statistics;
  double sum = 0.0, squares = 0.0;
  for (const double error : errors) {
    sum += error;
    squares += error * error;
  }
  const auto n = static_cast<double>(errors.size());
  std::sort(errors.begin(), errors.end());
  const std::size_t middle = errors.size() / 2;
  statistics.rmse = std::sqrt(squares / n);
  statistics.mean = sum / n;
  statistics.median = errors.size() % 2 == 1 ? errors[middle] : 0.5 * (errors[middle - 1] + errors[middle]);
  statistics.max = errors.back();
  return statistics;
}

}  // namespace semantic_topo_loop::core
