#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/detection.h"
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

}  // namespace semantic_topo_loop::core
