#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "semantic_topo_loop/geometry/se3.h"

namespace semantic_topo_loop::core {

struct DriftOptions {
  std::string model = "smooth";
  double position_m = 0.3;
  double rotation_deg = 5.0;

  template <class Visitor>
  void visit(Visitor& visitor) {
    visitor("drift.model", model, "smooth (steady drift) or jump (good locally, with three bursts of 8 frames)");
    visitor("drift.position_m", position_m, "largest position error of the odometry; both 0: exact odometry");
    visitor("drift.rotation_deg", rotation_deg, "largest rotation error of the odometry");
  }
  bool is_valid(std::string* error) const;
};

/// Replays the motion between consecutive poses with an error, so that the poses drift as an odometry's do: `smooth`
/// with a slowly varying rate, a scale error and noise, growing with motion; `jump` with little of that but three
/// bursts of 8 frames. The errors are scaled until the largest distance and angle from the truth are those asked for.
/// @param T_world_camera true poses, in time order
/// @return drifted poses in the same world, the first one exact; nullopt, with the values in `error`, if no drawn error
///         meets both levels (a rotation that alone moves the camera farther than the position level allows)
std::optional<std::vector<SE3>> drift_poses(const std::vector<SE3>& T_world_camera, const DriftOptions& options,
                                            std::uint64_t seed, std::string* error);

}  // namespace semantic_topo_loop::core
