#pragma once

#include <cstdint>
#include <set>
#include <utility>
#include <vector>

#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/loop_closure.h"
#include "semantic_topo_loop/types/map_correction.h"
#include "semantic_topo_loop/types/option_visitor.h"

namespace semantic_topo_loop::core {

/// How recorded detections are made worse, to measure what a detector's errors cost.
struct PerturbationOptions {
  double drop = 0.0;
  double relabel = 0.0;
  double jitter = 0.0;

  void visit(OptionVisitor& visitor) {
    visitor("drop", drop, share(), "share of boxes left out");
    visitor("relabel", relabel, share(), "share of boxes that get another class");
    visitor("jitter", jitter, share(), "standard deviation of a corner, share of the box's width (x) and height (y)");
  }
};

struct PerturbationCounts {
  int boxes = 0;  ///< of the input
  int dropped = 0;
  int relabelled = 0;  ///< of those not dropped
};

/// Corrupts every box by itself, in this order:
/// 1. drop: the box is left out with probability `drop`; an image keeps its place without boxes;
/// 2. relabel: with probability `relabel` the class becomes another one, uniform over the other classes of the input
///    (before anything was dropped); with one class only, labels stay;
/// 3. jitter: Gaussian errors, independent for x1, y1, x2 and y2. Corners that cross are swapped, so that boxes stay
///    boxes; they are not clipped, for the image's size is unknown here.
///
/// Every box takes the same random numbers whatever the options, so that one option leaves the others' effects as they
/// are: with the same seed, a larger `drop` leaves out more of the same boxes.
std::vector<DetectionFrame> perturb_detections(const std::vector<DetectionFrame>& frames,
                                               const PerturbationOptions& options, std::uint64_t seed,
                                               PerturbationCounts* counts);

struct FalseLoopOptions {
  int count = 10;
  int cluster_size = 1;
  int min_gap_keyframes = 15;
  int window_frames = 200;
  double distance_m = 1.0, rotation_deg = 30.0;
  double sigma_m = 0.03, sigma_deg = 1.0;

  void visit(OptionVisitor& visitor) {
    visitor("count", count, not_negative(), "loops");
    visitor("cluster", cluster_size, at_least(1),
            "loops of neighbouring keyframes that agree with each other, as aliased places give them");
    visitor("gap", min_gap_keyframes, at_least(1), "keyframes between query and match, at least");
    visitor("window", window_frames, not_negative(), "frames of the evidence on either side");
    visitor("distance", distance_m, not_negative(), "a loop contradicts the odometry by 1 to 2 times this, m");
    visitor("rotation", rotation_deg, not_negative(), "and by 1 to 2 times this angle about a random axis, degrees");
    visitor("sigma", sigma_m, positive(), "standard deviation that the loops state, of each axis, m");
    visitor("sigma_deg", sigma_deg, positive(), "the same of the rotation");
  }
};

/// Keyframe ids of query and match.
using KeyframePairs = std::set<std::pair<std::int64_t, std::int64_t>>;

/// Accepted loops that are wrong, to be handed to a pose graph at their query frames. No two join the same keyframes.
/// @param keyframes with the poses of the odometry, in order
/// @param taken pairs that no loop joins   @return in order of the query frame; fewer than `count` if there is no room
std::vector<LoopClosure> make_false_loops(const std::vector<KeyframePose>& keyframes, const FalseLoopOptions& options,
                                          std::uint64_t seed, KeyframePairs taken = {});

}  // namespace semantic_topo_loop::core
