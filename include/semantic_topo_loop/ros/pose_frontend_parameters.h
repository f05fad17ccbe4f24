#pragma once

#include <string>

#include "semantic_topo_loop/ros/stage.h"

namespace semantic_topo_loop {

/// Where PoseFrontend finds poses, calibration and image stamps.
struct PoseFrontendParameters : StageParameters {
  std::string pose_source = "tf";
  std::string trigger = "camera_info";
  std::string trajectory_file, camera_file;
  std::string odom_frame = "odom";
  std::string base_frame, camera_frame;
  double max_pose_gap_s = 0.1;
  double pose_timeout_s = 0.5;
  bool publish_odom_tf = false;
  bool use_points = false;

  template <class Visitor>
  void visit(Visitor& visitor) {
    StageParameters::visit(visitor);
    visitor("pose_source", pose_source, "where poses come from: tf, odometry (nav_msgs/Odometry) or file");
    visitor("trigger", trigger, "whose stamps make frames: camera_info or detections (detections_in)");
    visitor("trajectory_file", trajectory_file, "file: camera poses in the odometry frame, TUM format");
    visitor("camera_file", camera_file, "calibration that replaces camera_info's, see config/camera; empty: none");
    visitor("odom_frame", odom_frame, "tf frame of the odometry");
    visitor("base_frame", base_frame, "tf frame that publish_odom_tf moves; empty: the camera's");
    visitor("camera_frame", camera_frame, "tf frame of the camera's optical frame; empty: camera_info's");
    visitor("max_pose_gap_s", max_pose_gap_s, "poses farther apart are not interpolated between");
    visitor("pose_timeout_s", pose_timeout_s, "how long an image waits for its pose, wall time");
    visitor("publish_odom_tf", publish_odom_tf, "send odom_frame -> base_frame, for poses that are not in tf");
    visitor("use_points", use_points, "join the cloud on `points` that has the image's stamp");
  }
  bool is_valid(std::string* error) const;
  /// Whether a pose source other than tf reads tf too.
  bool needs_tf() const { return pose_source != "file" || !base_frame.empty(); }
};

}  // namespace semantic_topo_loop
