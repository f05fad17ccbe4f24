#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

struct KeyframePose {
  std::int64_t keyframe_id = -1;
  std::int64_t frame_id = -1;
  std::int64_t stamp_ns = 0;
  SE3 T_map_camera;
  double scale = 1.0;  ///< units of length of the map in one of the odometry about this keyframe
};

/// Whether the optimiser believes an accepted loop.
struct LoopVerdict {
  std::int64_t query_keyframe_id = -1, match_keyframe_id = -1;
  bool kept = false;
  std::string reason = {};  ///< why it is not kept, or what it repeats; may be empty
  bool is_extra = false;    ///< given from outside, not found
};

/// A stretch of odometry that is not believed.
struct OdometryFault {
  std::int64_t from_keyframe_id = -1, to_keyframe_id = -1;  ///< consecutive keyframes
  bool is_break = false;                                    ///< nothing is known; else a jump that the loops gave away
  double translation_m = 0.0, rotation_rad = 0.0;           ///< sigmas of what a jump is off, on each axis
};

/// What the odometry's errors are taken to be: see OdometryNoise, and NoiseEstimate for the factor on the loops'
/// sigmas.
struct OdometryReport {
  int stated_edges = 0;  ///< edges whose source states a covariance: the noise below is not used there
  double translation_m = 0.0, rotation_rad = 0.0;
  double steady_translation = 0.0, steady_rotation_rad = 0.0, scale = 0.0;
  double loop_factor = 1.0;
  std::vector<OdometryFault> faults;  ///< in order of the keyframes
};

/// What the pose graph says after a frame; `changed` is false, and the lists are empty, when nothing moved.
struct MapCorrection {
  std::int64_t frame_id = -1;
  bool changed = false;
  std::int64_t valid_to_keyframe_id = -1;  ///< last keyframe in the solution; later ones compose on T_map_odom
  /// Right for this frame; with a free scale it moves with the camera, and only so much as the scale is off.
  SE3 T_map_odom_old, T_map_odom;
  double scale = 1.0;                   ///< units of length of the map in one of the odometry, at this frame
  std::vector<KeyframePose> keyframes;  ///< every keyframe in the solution, in order of id
  std::vector<LoopVerdict> loops;       ///< every accepted loop so far, in order of acceptance
  OdometryReport odometry;              ///< as of this solution
  double duration_us = 0.0;
};

}  // namespace semantic_topo_loop::core
