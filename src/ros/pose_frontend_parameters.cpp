#include "ros/pose_frontend_parameters.h"

#include "ros/parameter_check.h"

namespace semantic_topo_loop {

bool PoseFrontendParameters::is_valid(std::string* error) const {
  if (!FrontendParameters::is_valid(error)) return false;
  if (pose_source != "file" && pose_source != "tf" && pose_source != "odometry") {
    return fail("pose_source", pose_source, "file, tf or odometry", error);
  }
  if (trigger != "camera_info" && trigger != "detections") {
    return fail("trigger", trigger, "camera_info or detections", error);
  }
  if (pose_source == "file" && trajectory_file.empty()) {
    return fail("trajectory_file", trajectory_file, "given with pose_source file", error);
  }
  if (publish_odom_tf && pose_source == "tf") {
    return fail("publish_odom_tf", "true", "false with pose_source tf, where somebody else sends it", error);
  }
  if (!(max_pose_gap_s > 0.0)) return fail("max_pose_gap_s", max_pose_gap_s, "> 0", error);
  if (!(pose_timeout_s >= 0.0)) return fail("pose_timeout_s", pose_timeout_s, ">= 0", error);
  return true;
}

}  // namespace semantic_topo_loop
