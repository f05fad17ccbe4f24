#pragma once

#include <tf2/buffer_core.h>
#include <tf2_msgs/TFMessage.h>

#include <cstdint>
#include <map>
#include <string>

#include "ros/pose_source.h"
#include "semantic_topo_loop/pipeline/pose_buffer.h"
#include "semantic_topo_loop/types/result.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop {

/// The transforms of /tf and /tf_static, with the promise that tf2 does not make: the moving edge below the odometry
/// frame is never interpolated across more than `max_gap_s`. Leading slashes of frame ids are stripped. When time jumps
/// back, what was said about the moving frames is forgotten.
class TfPoses : public PoseSource {
 public:
  TfPoses(std::string odom_frame, double max_gap_s);

  /// @return an error that names frames and value if a transform was left out (the others are taken)
  core::Status add(const tf2_msgs::TFMessage& message, bool is_static);
  /// T_odom_camera
  Answer at(std::int64_t stamp_ns, const std::string& camera_frame) override;
  /// T_target_source at a stamp as tf2 interpolates it, without the check of gaps: for the rigid part of a robot.
  std::optional<core::SE3> find(const std::string& target, const std::string& source, std::int64_t stamp_ns) const;

 private:
  core::Status add(const geometry_msgs::TransformStamped& transform, bool is_static);
  /// Where a sample with this stamp goes; forgets everything first if it says that time jumped back.
  core::PoseBuffer& moving_samples(const std::string& child, std::int64_t stamp_ns);
  std::string child_of_odom(const std::string& camera_frame) const;

  const std::string odom_frame_;
  const double max_gap_s_;
  tf2::BufferCore buffer_;
  std::map<std::string, core::PoseBuffer> moving_;  ///< T_parent_child by child frame
};

}  // namespace semantic_topo_loop
