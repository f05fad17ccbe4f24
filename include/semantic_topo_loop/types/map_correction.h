#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/solved_motion.h"
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
  std::int64_t number = -1;  ///< of the loop, counted from 0 in order of acceptance
  std::int64_t query_keyframe_id = -1, match_keyframe_id = -1;
  bool kept = false;
  std::string reason = {};  ///< why it is not kept, or what it repeats; may be empty
  bool is_extra = false;    ///< given from outside, not found
};

/// A stretch of odometry that is not believed: a break, where nothing is known; a jump that the loops gave away; or
/// what it missed though what was in view moved: a freeze, where it stood still, or a slip, where it went another way.
struct OdometryFault {
  std::int64_t from_keyframe_id = -1, to_keyframe_id = -1;  ///< neighbours in the graph
  bool is_break = false;
  double translation_m = 0.0, rotation_rad = 0.0;  ///< sigmas of what a jump is off, on each axis
  double frozen_s = 0.0, slipped_s = 0.0;          ///< how long a freeze and a slip lasted
};

/// What the odometry's errors are taken to be: see OdometryNoise, and NoiseEstimate for the factor on the loops'
/// sigmas.
struct OdometryReport {
  int stated_edges = 0;  ///< of this session, whose source states a covariance: the noise below is not used there
  double translation_m = 0.0, rotation_rad = 0.0;
  double steady_translation = 0.0, steady_rotation_rad = 0.0, scale = 0.0;
  double loop_factor = 1.0;
  double delay_s = 0.0;       ///< by how much its poses were last taken to be late against the images; < 0: early
  ShortTermNoise short_term;  ///< as it was last taken to be; 0 before anything is known
  /// In order of the keyframes; breaks, freezes and slips of earlier sessions too, jumps of this one's odometry alone.
  std::vector<OdometryFault> faults;
};

/// What the pose graph says after a frame; `changed` is false, and the lists are empty, when nothing moved. The lists
/// hold what is new: who missed a correction is brought up to date by that of the end frame, whose keyframes are
/// complete.
struct MapCorrection {
  std::int64_t frame_id = -1;
  bool changed = false;
  std::int64_t valid_to_keyframe_id = -1;  ///< last keyframe in the solution; later ones compose on T_map_odom
  /// Right for this frame; with a free scale it moves with the camera, and only so much as the scale is off.
  SE3 T_map_odom_old, T_map_odom;
  double scale = 1.0;  ///< units of length of the map in one of the odometry, at this frame
  /// Those in the solution that are new or have moved by more than 0.2 mm or 0.1 mrad since they were last told; the
  /// end frame's: all. In order of id.
  std::vector<KeyframePose> keyframes;
  std::vector<LoopVerdict> loops;  ///< those that are new or other than last told, in order of acceptance
  OdometryReport odometry;         ///< as of this solution
  double duration_us = 0.0;
};

}  // namespace semantic_topo_loop::core
