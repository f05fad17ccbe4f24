#pragma once

#include <string>

#include "ros/stage.h"

namespace semantic_topo_loop {

/// What every front end has: its calibration and its frames.
struct FrontendParameters : StageParameters {
  std::string camera_file;
  std::string odom_frame = "odom";
  std::string base_frame, camera_frame;
  bool publish_odom_tf = false;

  template <class Visitor>
  void visit(Visitor& visitor) {
    StageParameters::visit(visitor);
    visitor("camera_file", camera_file, "calibration that replaces camera_info's, see config/camera; empty: none");
    visitor("odom_frame", odom_frame, "tf frame of the odometry");
    visitor("base_frame", base_frame, "tf frame that publish_odom_tf moves; empty: the camera's");
    visitor("camera_frame", camera_frame, "tf frame of the camera's optical frame; empty: camera_info's");
    visitor("publish_odom_tf", publish_odom_tf, "send odom_frame -> base_frame, for poses that are not in tf");
  }
  bool is_valid(std::string* error) const;
};

}  // namespace semantic_topo_loop
