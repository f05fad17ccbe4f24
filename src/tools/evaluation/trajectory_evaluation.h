#pragma once

#include <cstddef>
#include <optional>
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

/// Distance of an estimated pose from its partner after alignment.
struct PoseError {
  std::int64_t stamp_ns = 0;
  double error_m = 0.0;
};

/// Absolute and relative errors of a trajectory, as TUM's tools compute them: of each pose of the sparser one, estimate
/// or reference, and that of the other which is nearest in time, where they are less than 0.02 s apart.
struct TrajectoryEvaluation {
  std::size_t estimated = 0, reference = 0;  ///< poses of the two files
  std::size_t pairs = 0;                     ///< poses that have a partner
  Alignment alignment;                       ///< T_reference_estimate
  ErrorStatistics absolute_m;                ///< ATE: distances after alignment
  ErrorStatistics absolute_deg;              ///< angles between the orientations after alignment
  std::vector<PoseError> errors;             ///< these distances, in order of time
  ErrorStatistics relative_m;                ///< RPE over 1 s, translation
  ErrorStatistics relative_deg;              ///< RPE over 1 s, rotation
};

/// @param with_scale align by a similarity (monocular odometry)
/// @param known that of the estimate's frame, instead of the one that suits the estimate best
/// @return an error, with the cause, if fewer than 3 poses have a partner or they lie on one line; with a known
///     alignment, if none has a partner
Result<TrajectoryEvaluation> evaluate_trajectory(const StampedPoses& estimate, const StampedPoses& reference,
                                                 bool with_scale = false,
                                                 const std::optional<Alignment>& known = std::nullopt);

}  // namespace semantic_topo_loop::core
