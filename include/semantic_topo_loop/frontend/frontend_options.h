#pragma once

#include "semantic_topo_loop/types/option_visitor.h"

namespace semantic_topo_loop::core {

/// Visual odometry from color and depth images.
struct FrontendOptions {
  int features = 1000;
  int levels = 8;
  double scale_factor = 1.2;
  int corner_threshold = 7;
  int registration_px = 4;
  int min_inliers = 20;
  double restart_after_s = 2.0;
  int window_keyframes = 10;
  int window_iterations = 6;
  int max_keyframes = 600;
  bool self_calibration = true;
  int point_stride_px = 4;

  void visit(OptionVisitor& visitor) {
    visitor.module("frontend");
    visitor("features", features, between(100, 10000), "ORB features an image, spread evenly over it");
    visitor("levels", levels, between(1, 12), "levels of the image pyramid");
    visitor("scale_factor", scale_factor, above(1).at_most(2), "between two levels of the pyramid");
    visitor("corner_threshold", corner_threshold, between(1, 100), "smallest contrast of a corner, grey levels");
    visitor("registration_px", registration_px, between(0, 50),
            "depth is taken to be off by up to this many pixels against the color image");
    visitor("min_inliers", min_inliers, at_least(6), "fewer features that agree on a pose are no pose");
    visitor("restart_after_s", restart_after_s, not_negative(),
            "lost for longer, or than the odometry is old, it starts anew from the last pose, with a break");
    visitor("window_keyframes", window_keyframes, at_least(2), "keyframes refined by a local bundle adjustment");
    visitor("window_iterations", window_iterations, at_least(1), "iterations of a local bundle adjustment at most");
    visitor("max_keyframes", max_keyframes, any(), "keyframes kept; the oldest ones are forgotten");
    visitor("self_calibration", self_calibration,
            "find out where depth is not registered to color, and correct focal lengths that are clearly wrong");
    visitor(
        "point_stride_px", point_stride_px, at_least(1),
        "grid of depth pixels that a frame hands on as points; of an image 640 pixels wide, wider ones in proportion");
    visitor.require("max_keyframes", max_keyframes >= 2 * window_keyframes, ">= 2 frontend.window_keyframes");
  }
};

}  // namespace semantic_topo_loop::core
