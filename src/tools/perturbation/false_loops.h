#pragma once

#include <cstdint>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "semantic_topo_loop/types/loop_closure.h"
#include "semantic_topo_loop/types/map_correction.h"

namespace semantic_topo_loop::core {

struct FalseLoopOptions {
  int count = 10;
  /// Loops of neighbouring keyframes that agree with each other, as aliased places give them; 1: each by itself.
  int cluster_size = 1;
  int min_gap_keyframes = 15;  ///< between query and match
  int window_frames = 200;     ///< of the evidence on either side
  /// How far a loop contradicts the odometry: a translation in a random direction by 1 to 2 times `distance_m`, and a
  /// rotation about a random axis by 1 to 2 times `rotation_deg`.
  double distance_m = 1.0, rotation_deg = 30.0;
  double sigma_m = 0.03, sigma_deg = 1.0;  ///< that the loops state, of each axis
  bool is_valid(std::string* error) const;
};

/// Keyframe ids of query and match.
using KeyframePairs = std::set<std::pair<std::int64_t, std::int64_t>>;

/// Accepted loops that are wrong, to be handed to a pose graph at their query frames. No two join the same keyframes.
/// @param keyframes with the poses of the odometry, in order
/// @param taken pairs that no loop joins   @return in order of the query frame; fewer than `count` if there is no room
std::vector<LoopClosure> make_false_loops(const std::vector<KeyframePose>& keyframes, const FalseLoopOptions& options,
                                          std::uint64_t seed, KeyframePairs taken = {});

}  // namespace semantic_topo_loop::core
