#pragma once

#include <string>

#include "ros/frontend_parameters.h"

namespace semantic_topo_loop {

/// Where PoseFrontend finds poses and image stamps.
struct PoseFrontendParameters : FrontendParameters {
  std::string pose_source = "tf";
  std::string trigger = "camera_info";
  std::string trajectory_file;
  double max_pose_gap_s = 0.1;
  double pose_timeout_s = 0.5;
  bool use_points = false;

  template <class Visitor>
  void visit(Visitor& visitor) {
    FrontendParameters::visit(visitor);
    visitor("pose_source", pose_source, "where poses come from: tf, odometry (nav_msgs/Odometry) or file");
    visitor("trigger", trigger, "whose stamps make frames: camera_info or detections (detections_in)");
    visitor("trajectory_file", trajectory_file, "file: camera poses in the odometry frame, TUM format");
    visitor("max_pose_gap_s", max_pose_gap_s, "poses farther apart are not interpolated between");
    visitor("pose_timeout_s", pose_timeout_s, "how long an image waits for its pose, wall time");
    visitor("use_points", use_points, "join the cloud on `points` that has the image's stamp");
  }
  bool is_valid(std::string* error) const;
  /// Whether a pose source other than tf reads tf too.
  bool needs_tf() const { return pose_source != "file" || !base_frame.empty(); }
};

}  // namespace semantic_topo_loop
