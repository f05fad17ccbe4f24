#pragma once

#include <string>

#include "semantic_topo_loop/types/option_visitor.h"

namespace semantic_topo_loop::core {

/// The simulated RGB-D camera. Its depth camera has the intrinsics of the color camera.
struct RenderingOptions {
  bool noise = true;
  double depth_scale = 5000.0;
  int far_value = 0;
  double depth_delay_s = 0.008;
  double depth_offset_m = 0.0;

  void visit(OptionVisitor& visitor) {
    visitor("rendering.noise", noise, "errors and holes of a Kinect; false: ideal colors and depths");
    // 16 bits must reach the camera's 6 m, and a step must not exceed a centimetre.
    visitor("rendering.depth_scale", depth_scale, between(100, 10000),
            "PNG: units a metre; 5000 as TUM's, 1000 for millimetres");
    visitor("rendering.far_value", far_value, any(),
            "PNG: value of what is out of range, 0 or 65535; other holes are 0");
    visitor("rendering.depth_delay_s", depth_delay_s, between(-0.1, 0.1),
            "from a color image to its depth image, each taken at its own time; Kinects have some 10 ms");
    visitor("rendering.depth_offset_m", depth_offset_m, between(-0.2, 0.2),
            "how far right of the color camera the depth camera sits; 0: depth is registered to the color image");
    visitor.require("rendering.far_value", far_value == 0 || far_value == 65535, "0 or 65535");
  }
};

}  // namespace semantic_topo_loop::core
