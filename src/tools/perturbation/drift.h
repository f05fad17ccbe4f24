#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/option_visitor.h"
#include "semantic_topo_loop/types/result.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

struct DriftOptions {
  std::string model = "smooth";
  double position_m = 0.3;
  double rotation_deg = 5.0;
  double scale_percent = 0.0;
  double global_scale = 1.0;

  void visit(OptionVisitor& visitor) {
    visitor.module("drift");
    visitor("model", model, one_of({"smooth", "jump"}),
            "smooth (steady drift) or jump (good locally, with three bursts of 8 frames)");
    visitor("position_m", position_m, not_negative(), "largest position error of the odometry; both 0: exact odometry");
    visitor("rotation_deg", rotation_deg, at_least(0).below(170), "largest rotation error of the odometry");
    visitor("scale_percent", scale_percent, not_negative(),
            "monocular odometry: largest change of its scale since the first pose, by a random walk");
    visitor("global_scale", global_scale, positive(), "monocular odometry: its units of length in a metre, at first");
  }
};

/// Replays the motion between consecutive poses with an error, so that the poses drift as an odometry's do: `smooth`
/// with a slowly varying rate, a scale error and noise, growing with motion; `jump` with little of that but three
/// bursts of 8 frames. The errors are scaled until the largest distance and angle from the truth are those asked for.
/// @param T_world_camera true poses, in time order
/// @return drifted poses in the same world, the first one exact; an error that names both levels if no drawn error
/// meets them (a rotation that alone moves the camera farther than the position level allows)
Result<std::vector<SE3>> drift_poses(const std::vector<SE3>& T_world_camera, const DriftOptions& options,
                                     std::uint64_t seed);

/// Replays the motion in a unit of length that is `global_scale` at first and then drifts as a monocular odometry's
/// does: a random walk of its logarithm along the path, whose largest change is log(1 + scale_percent / 100).
/// @return poses that begin at the same one; those given where there is nothing to change
std::vector<SE3> drift_scale(const std::vector<SE3>& T_world_camera, const DriftOptions& options, std::uint64_t seed);

}  // namespace semantic_topo_loop::core
