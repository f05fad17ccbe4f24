#pragma once

#include <string>

#include "semantic_topo_loop/types/result.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop::core {

/// Reads a trajectory in TUM format: `stamp tx ty tz qx qy qz qw` a line, `#` comments. Quaternions are normalised.
/// @return an error, with file, line and value, for a missing or empty file, a line with another number of
/// columns, a value that is no finite number, a quaternion whose norm is off by more than 0.01, or a stamp that is not
/// after the one before
Result<StampedPoses> read_tum_trajectory(const std::string& path);

/// The same for the ground truth of a benchmark, where a stamp may be repeated (TUM's freiburg2_desk has one): the last
/// pose of a stamp counts, as in TUM's tools.
Result<StampedPoses> read_tum_ground_truth(const std::string& path);

/// One line without its end: stamp as of format_stamp, numbers with 9 decimals.
std::string format_tum_pose(const StampedPose& pose);
/// Writes one line a pose, atomically.
Status write_tum_trajectory(const std::string& path, const StampedPoses& trajectory);

}  // namespace semantic_topo_loop::core
