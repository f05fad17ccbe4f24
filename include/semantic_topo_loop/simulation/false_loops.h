#pragma once

#include <cstdint>
#include <vector>

#include "semantic_topo_loop/loop/loop_closure.h"
#include "semantic_topo_loop/pose_graph/map_correction.h"

namespace semantic_topo_loop::core {

struct FalseLoopOptions {
  int count = 10;
  /// Loops of neighbouring keyframes that agree with each other, as aliased places give them; 1: each by itself.
  int cluster_size = 1;
  int min_gap_keyframes = 15;
  int window_frames = 200;  ///< of the evidence on either side
  double distance_m = 2.0;  ///< sigma of each axis of the wrong relative position; the rotation is any
  Mat6 covariance = 1e-3 * Mat6::Identity();  ///< that the loops state
};

/// Accepted loops that are wrong, to be handed to a pose graph at their query frames.
/// @param keyframes with the poses of the odometry, in order   @return in order of the query frame; empty if there are
///        too few keyframes
std::vector<LoopClosure> make_false_loops(const std::vector<KeyframePose>& keyframes, const FalseLoopOptions& options,
                                          std::uint64_t seed);

}  // namespace semantic_topo_loop::core
