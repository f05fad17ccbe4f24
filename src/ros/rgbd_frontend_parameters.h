#pragma once

#include <string>

#include "ros/frontend_parameters.h"

namespace semantic_topo_loop {

/// How RgbdFrontend takes its images.
struct RgbdFrontendParameters : FrontendParameters {
  std::string color_transport = "raw";
  std::string depth_transport = "raw";
  int color_queue_size = 10;
  int depth_queue_size = 10;
  int sync_queue_size = 10;
  double max_depth_delay_s = 0.02;
  double pair_timeout_s = 1.0;
  double starvation_s = 3.0;

  template <class Visitor>
  void visit(Visitor& visitor) {
    FrontendParameters::visit(visitor);
    visitor("color_transport", color_transport, "image_transport of color: raw, compressed, ...");
    visitor("depth_transport", depth_transport, "image_transport of depth: raw, compressedDepth, ...");
    visitor("color_queue_size", color_queue_size, "colour images that wait for the callback");
    visitor("depth_queue_size", depth_queue_size, "depth images that wait for the callback");
    visitor("sync_queue_size", sync_queue_size, "images of a topic that wait for the other one");
    visitor("max_depth_delay_s", max_depth_delay_s, "colour and depth farther apart in stamp do not belong together");
    visitor("pair_timeout_s", pair_timeout_s, "how long a colour image waits for its depth, wall time");
    visitor("starvation_s", starvation_s, "a topic that is silent for longer is reported, wall time");
  }
  bool is_valid(std::string* error) const;
};

}  // namespace semantic_topo_loop
