#pragma once

#include <cstddef>
#include <utility>
#include <vector>

#include "semantic_topo_loop/geometry/alignment.h"
#include "semantic_topo_loop/types/result.h"
#include "semantic_topo_loop/types/stamp.h"

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

struct TrajectoryEvaluationOptions {
  double max_stamp_difference_s = 0.02;  ///< as TUM's tools
  double relative_interval_s = 1.0;      ///< between the two poses of a relative error
  bool with_scale = false;               ///< align by a similarity (monocular odometry)
};

/// Absolute and relative errors of a trajectory, as TUM's tools compute them.
struct TrajectoryEvaluation {
  std::size_t estimated = 0, reference = 0;  ///< poses of the two files
  std::size_t pairs = 0;                     ///< poses that have a partner
  Alignment alignment;                       ///< T_reference_estimate
  ErrorStatistics absolute_m;                ///< ATE: distances after alignment
  ErrorStatistics relative_m;                ///< RPE over the interval, translation
  ErrorStatistics relative_deg;              ///< RPE over the interval, rotation
};

/// Pairs of indices (estimate, reference): for each estimate the reference nearest in time, if it is less than
/// `max_difference_s` away. Two estimates may share a reference.
std::vector<std::pair<std::size_t, std::size_t>> associate_stamps(const StampedPoses& estimate,
                                                                  const StampedPoses& reference,
                                                                  double max_difference_s);

/// @return an error, with the cause, if fewer than 3 poses have a partner or they lie on one line
Result<TrajectoryEvaluation> evaluate_trajectory(const StampedPoses& estimate, const StampedPoses& reference,
                                                 const TrajectoryEvaluationOptions& options);

}  // namespace semantic_topo_loop::core
