#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "semantic_topo_loop/geometry/se3.h"

namespace semantic_topo_loop::core {

struct KeyframePose {
  std::int64_t keyframe_id = -1;
  std::int64_t frame_id = -1;
  std::int64_t stamp_ns = 0;
  SE3 T_map_camera;
};

/// Whether the optimiser believes an accepted loop.
struct LoopVerdict {
  std::int64_t query_keyframe_id = -1, match_keyframe_id = -1;
  bool kept = false;
  std::string reason = {};  ///< why it is not kept, or what it repeats; may be empty
};

/// What the pose graph says after a frame; `changed` is false, and the lists are empty, when nothing moved.
struct MapCorrection {
  std::int64_t frame_id = -1;
  bool changed = false;
  std::int64_t valid_to_keyframe_id = -1;  ///< last keyframe in the solution; later ones compose on T_map_odom
  SE3 T_map_odom_old, T_map_odom;
  std::vector<KeyframePose> keyframes;  ///< every keyframe in the solution, in order of id
  std::vector<LoopVerdict> loops;       ///< every accepted loop so far, in order of acceptance
  double duration_us = 0.0;
};

}  // namespace semantic_topo_loop::core
