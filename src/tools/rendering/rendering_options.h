#pragma once

#include <string>

namespace semantic_topo_loop::core {

/// The simulated RGB-D camera. Its depth camera has the intrinsics of the colour camera.
struct RenderingOptions {
  bool noise = true;
  double depth_scale = 5000.0;
  int far_value = 0;
  double depth_delay_s = 0.008;
  double depth_offset_m = 0.0;

  template <class Visitor>
  void visit(Visitor& visitor) {
    visitor("rendering.noise", noise, "errors and holes of a Kinect; false: ideal colours and depths");
    visitor("rendering.depth_scale", depth_scale, "PNG: units a metre; 5000 as TUM's, 1000 for millimetres");
    visitor("rendering.far_value", far_value, "PNG: value of what is out of range, 0 or 65535; other holes are 0");
    visitor("rendering.depth_delay_s", depth_delay_s,
            "from a colour image to its depth image, each taken at its own time; Kinects have some 10 ms");
    visitor("rendering.depth_offset_m", depth_offset_m,
            "how far right of the colour camera the depth camera sits; 0: depth is registered to the colour image");
  }
  bool is_valid(std::string* error) const;
};

}  // namespace semantic_topo_loop::core
