#pragma once

#include <string>

namespace semantic_topo_loop::core {

/// Visual odometry from colour and depth images.
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

  template <class Visitor>
  void visit(Visitor& visitor) {
    visitor("frontend.features", features, "ORB features an image, spread evenly over it");
    visitor("frontend.levels", levels, "levels of the image pyramid");
    visitor("frontend.scale_factor", scale_factor, "between two levels of the pyramid");
    visitor("frontend.corner_threshold", corner_threshold, "smallest contrast of a corner, grey levels");
    visitor("frontend.registration_px", registration_px,
            "depth is taken to be off by up to this many pixels against the colour image");
    visitor("frontend.min_inliers", min_inliers, "fewer features that agree on a pose are no pose");
    visitor("frontend.restart_after_s", restart_after_s,
            "lost for longer, the odometry starts anew from the last pose, with a break");
    visitor("frontend.window_keyframes", window_keyframes, "keyframes refined by a local bundle adjustment");
    visitor("frontend.window_iterations", window_iterations, "iterations of a local bundle adjustment at most");
    visitor("frontend.max_keyframes", max_keyframes, "keyframes kept; the oldest ones are forgotten");
    visitor("frontend.self_calibration", self_calibration,
            "find out where depth is not registered to colour, and correct focal lengths that are clearly wrong");
    visitor("frontend.point_stride_px", point_stride_px, "grid of depth pixels that a frame hands on as points");
  }
  bool is_valid(std::string* error) const;
};

}  // namespace semantic_topo_loop::core
