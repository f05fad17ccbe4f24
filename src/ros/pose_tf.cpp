#include "ros/pose_tf.h"

#include <tf2/exceptions.h>

#include <utility>

#include "ros/conversions.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop {
namespace {

constexpr char kAuthority[] = "semantic_topo_loop";

geometry_msgs::Pose to_pose(const geometry_msgs::Transform& transform) {
  geometry_msgs::Pose pose;
  pose.position.x = transform.translation.x;
  pose.position.y = transform.translation.y;
  pose.position.z = transform.translation.z;
  pose.orientation = transform.rotation;
  return pose;
}

}  // namespace

TfPoses::TfPoses(std::string odom_frame, double max_gap_s)
    : odom_frame_(std::move(odom_frame)), max_gap_s_(max_gap_s), buffer_(ros::Duration(kKeepPoses_s)) {}

core::Status TfPoses::add(const tf2_msgs::TFMessage& message, bool is_static) {
  core::Status all;
  for (const geometry_msgs::TransformStamped& transform : message.transforms) {
    if (core::Status added = add(transform, is_static); !added) all = std::move(added);
  }
  return all;
}

core::Status TfPoses::add(const geometry_msgs::TransformStamped& transform, bool is_static) {
  geometry_msgs::TransformStamped stripped = transform;
  stripped.header.frame_id = strip_leading_slash(transform.header.frame_id);
  stripped.child_frame_id = strip_leading_slash(transform.child_frame_id);
  const std::string name = "tf " + stripped.header.frame_id + " -> " + stripped.child_frame_id;
  const core::Result<core::SE3> pose = checked_pose(to_pose(transform.transform), name);
  if (!pose) return pose.error();
  stripped.transform.rotation = to_msg(*pose).orientation;
  if (!is_static) {
    const std::int64_t stamp_ns = to_stamp_ns(transform.header.stamp);
    core::PoseBuffer& samples = moving_samples(stripped.child_frame_id, stamp_ns);
    if (samples.has(stamp_ns)) return {};  // robots publish the same transform again and again
    if (const core::Status added = samples.add(stamp_ns, *pose); !added) {
      return core::Error{name + ": " + added.message()};
    }
  }
  if (buffer_.setTransform(stripped, kAuthority, is_static)) return {};
  return core::Error{name + " at stamp " + core::format_stamp(to_stamp_ns(transform.header.stamp)) +
                     " is refused by tf2: a frame id is missing, or the stamp is too old"};
}

core::PoseBuffer& TfPoses::moving_samples(const std::string& child, std::int64_t stamp_ns) {
  core::PoseBuffer& samples = moving_.try_emplace(child, max_gap_s_, kKeepPoses_s).first->second;
  if (!samples.empty() && stamp_ns < samples.newest_ns() - kJumpBack_ns) {
    buffer_.clear();
    for (auto& [name, others] : moving_) others.clear();
  }
  return samples;
}

std::string TfPoses::child_of_odom(const std::string& camera_frame) const {
  std::string child = camera_frame;
  std::string parent;
  // A loop in the tree, which tf2 does not refuse, must not hang us.
  for (std::size_t depth = 0; depth < 100 && buffer_._getParent(child, ros::Time(), parent); ++depth) {
    if (parent == odom_frame_) return child;
    child = parent;
  }
  return {};
}

PoseSource::Answer TfPoses::at(std::int64_t stamp_ns, const std::string& camera_frame) {
  Answer answer;
  answer.sample.stamp_ns = stamp_ns;
  const std::string child = child_of_odom(camera_frame);
  if (child.empty()) {
    answer.problem = "tf has no chain from '" + odom_frame_ + "' down to '" + camera_frame + "'";
    return answer;
  }
  core::SE3 T_odom_child;
  const auto samples = moving_.find(child);
  if (samples != moving_.end()) {
    const core::PoseBuffer::Answer pose = samples->second.at(stamp_ns);
    if (pose.status != core::PoseBuffer::Status::kFound) {
      answer.problem = "tf " + odom_frame_ + " -> " + child + ": " + describe(pose.status);
      if (pose.status != core::PoseBuffer::Status::kNotYet) answer.status = Status::kNever;
      return answer;
    }
    T_odom_child = pose.pose;
  } else if (const std::optional<core::SE3> fixed = find(odom_frame_, child, stamp_ns)) {
    T_odom_child = *fixed;
  }
  const std::optional<core::SE3> T_child_camera = find(child, camera_frame, stamp_ns);
  if (!T_child_camera) {
    answer.problem = "tf from '" + child + "' to '" + camera_frame + "' does not reach the stamp";
    return answer;
  }
  answer.status = Status::kFound;
  answer.sample.T_odom_camera = T_odom_child * *T_child_camera;
  return answer;
}

std::optional<core::SE3> TfPoses::find(const std::string& target, const std::string& source,
                                       std::int64_t stamp_ns) const {
  if (target == source) return core::SE3();
  try {
    const core::SE3 T = from_msg(to_pose(buffer_.lookupTransform(target, source, to_ros_time(stamp_ns)).transform));
    return core::SE3(T.q.normalized(), T.t);
  } catch (const tf2::TransformException&) {
    return std::nullopt;
  }
}

}  // namespace semantic_topo_loop
