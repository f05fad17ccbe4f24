#pragma once

#include <cstdint>

#include "semantic_topo_loop/types/eigen.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// What of a motion the odometry missed, so that what is in view told it.
struct MissedMotion {
  /// For how long it stood still though what was in view moved; with the motions next to that where it was bridged.
  double frozen_s = 0.0;
  double slipped_s = 0.0;          ///< for how long it went another way than what was in view tells
  Mat6 covariance = Mat6::Zero();  ///< how well that is known: right, (translation m, rotation rad)

  bool is_any() const { return frozen_s > 0.0 || slipped_s > 0.0; }
};

/// What an odometry is taken to be off by over some seconds (1 sigma an axis), as what is in view tells: steps that are
/// independent, and a drift that lasts.
struct ShortTermNoise {
  double step_m = 0.0, step_rad = 0.0;        ///< after a second, grow with the root of the time
  double drift_mps = 0.0, drift_radps = 0.0;  ///< m/s and rad/s, the same for seconds on end
};

/// How the camera moved from a keyframe to the next, solved for with the objects that it saw on the way.
struct SolvedMotion {
  std::int64_t from_keyframe_id = -1, to_keyframe_id = -1;
  SE3 T_from_to;
  double path_m = 0.0;        ///< length of the way
  double rotation_rad = 0.0;  ///< sum of the rotation angles on it
  MissedMotion missed;
  double delay_s = 0.0;  ///< by how much the odometry's poses were taken to be late against the images; < 0: early
  ShortTermNoise noise;  ///< of the odometry, as it was taken to be
};

}  // namespace semantic_topo_loop::core
