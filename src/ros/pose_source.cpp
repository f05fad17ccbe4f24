#include "ros/pose_source.h"

#include <tf2/exceptions.h>

#include <algorithm>

#include "geometry/relative_pose.h"
#include "ros/conversions.h"

namespace semantic_topo_loop {
namespace {

/// How long poses are kept, s: longer than any image waits for its own.
constexpr double kKeepPoses_s = 60.0;
constexpr char kAuthority[] = "semantic_topo_loop";

geometry_msgs::Pose to_pose(const geometry_msgs::Transform& transform) {
  const geometry_msgs::Vector3& t = transform.translation;
  geometry_msgs::Pose pose;
  pose.position = to_xyz<geometry_msgs::Point>({t.x, t.y, t.z});
  pose.orientation = transform.rotation;
  return pose;
}

/// Drivers write 1e3 and more for "unknown".
constexpr double kLargestVariance = 1e2;

std::optional<core::Mat6> to_covariance(const boost::array<double, 36>& values) {
  const core::Mat6 covariance = Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(values.data());
  if (!core::is_covariance(covariance) || covariance.diagonal().maxCoeff() > kLargestVariance) return std::nullopt;
  return covariance;
}

PoseSource::Answer found(std::int64_t stamp_ns, const core::SE3& T_odom_camera) {
  PoseSource::Answer answer;
  answer.status = PoseSource::Status::kFound;
  answer.sample.stamp_ns = stamp_ns;
  answer.sample.T_odom_camera = T_odom_camera;
  return answer;
}

/// @param who of the buffer that has no pose
PoseSource::Answer missing(const std::string& who, core::PoseBuffer::Status status) {
  const bool may_come = status == core::PoseBuffer::Status::kNotYet;
  return {may_come ? PoseSource::Status::kNotYet : PoseSource::Status::kNever, {}, who + ": " + describe(status)};
}

}  // namespace

PoseSource::Answer FilePoses::at(std::int64_t stamp_ns, const std::string& /*camera_frame*/) {
  const core::StampedPose* pose = core::find_stamp(trajectory_, stamp_ns, kStampTolerance_ns);
  if (pose == nullptr) {
    return {Status::kNever, {}, "the trajectory file has no pose within 1 us of stamp " + core::format_stamp(stamp_ns)};
  }
  return found(stamp_ns, pose->T_world_camera);
}

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
  if (!samples.empty() && stamp_ns < samples.newest_ns() - kJumpBack_ns && is_needed(child)) {
    buffer_.clear();
    for (auto& [name, others] : moving_) others.clear();
  }
  return samples;
}

std::vector<std::string> TfPoses::ancestors(const std::string& frame) const {
  constexpr std::size_t kDeepest = 100;  // a loop in the tree, which tf2 does not refuse, must not hang us
  std::vector<std::string> frames = {frame};
  std::string parent;
  while (frames.size() < kDeepest && buffer_._getParent(frames.back(), ros::Time(), parent) && parent != odom_frame_) {
    frames.push_back(parent);
  }
  return frames;
}

bool TfPoses::is_needed(const std::string& child) const {
  return asked_.empty() || std::any_of(asked_.begin(), asked_.end(), [this, &child](const std::string& frame) {
           const std::vector<std::string> frames = ancestors(frame);
           return std::find(frames.begin(), frames.end(), child) != frames.end();
         });
}

PoseSource::Answer TfPoses::at(std::int64_t stamp_ns, const std::string& camera_frame) {
  asked_.insert(camera_frame);
  const std::string child = root(camera_frame);
  std::string parent;
  if (!buffer_._getParent(child, ros::Time(), parent) || parent != odom_frame_) {
    return {Status::kNotYet, {}, "tf has no chain from '" + odom_frame_ + "' down to '" + camera_frame + "'"};
  }
  core::SE3 T_odom_child;
  bool is_continuous = false;
  const auto samples = moving_.find(child);
  if (samples != moving_.end()) {
    const core::PoseBuffer::Answer pose = samples->second.at(stamp_ns);
    if (pose.status != core::PoseBuffer::Status::kFound) {
      return missing("tf " + odom_frame_ + " -> " + child, pose.status);
    }
    T_odom_child = pose.pose;
    is_continuous = last_stamp_ns_ && samples->second.is_continuous(*last_stamp_ns_, stamp_ns);
  } else if (const std::optional<core::SE3> fixed = find(odom_frame_, child, stamp_ns)) {
    T_odom_child = *fixed;
  }
  const std::optional<core::SE3> T_child_camera = find(child, camera_frame, stamp_ns);
  if (!T_child_camera) {
    return {Status::kNotYet, {}, "tf from '" + child + "' to '" + camera_frame + "' does not reach the stamp"};
  }
  Answer answer = found(stamp_ns, T_odom_child * *T_child_camera);
  answer.sample.is_continuous = is_continuous;
  return answer;
}

std::optional<core::SE3> TfPoses::find(const std::string& target, const std::string& source, std::int64_t stamp_ns) {
  if (target == source) return core::SE3();
  asked_.insert({target, source});
  try {
    const core::SE3 T = from_msg(to_pose(buffer_.lookupTransform(target, source, to_ros_time(stamp_ns)).transform));
    return core::SE3(T.q.normalized(), T.t);
  } catch (const tf2::TransformException&) {
    return std::nullopt;
  }
}

OdometryPoses::OdometryPoses(std::shared_ptr<TfPoses> transforms, double max_gap_s, std::string base_frame)
    : transforms_(std::move(transforms)), poses_(max_gap_s, kKeepPoses_s), base_frame_(std::move(base_frame)) {}

core::Status OdometryPoses::add(const nav_msgs::Odometry& message) {
  const core::Result<core::SE3> pose = checked_pose(message.pose.pose, "odometry pose");
  if (!pose) return pose.error();
  std::string child = strip_leading_slash(message.child_frame_id);
  // tf has that frame's own place: the motion would count twice.
  const bool is_parent = !child.empty() && child == strip_leading_slash(message.header.frame_id);
  if (is_parent && base_frame_.empty()) {
    return core::Error{"odometry child_frame_id = '" + child +
                       "' is its header's frame_id; base_frame can name the frame that moves"};
  }
  if (is_parent || child.empty()) child = base_frame_;
  const std::int64_t stamp_ns = to_stamp_ns(message.header.stamp);
  if (!poses_.empty() && stamp_ns < poses_.newest_ns() - kJumpBack_ns) {
    poses_.clear();
    twist_covariances_.clear();
  }
  if (const core::Status added = poses_.add(stamp_ns, *pose); !added) return added.error();
  moved_frame_ = std::move(child);
  twist_covariances_[stamp_ns] = to_covariance(message.twist.covariance);
  const std::int64_t oldest_ns = poses_.newest_ns() - static_cast<std::int64_t>(kKeepPoses_s * 1e9);
  twist_covariances_.erase(twist_covariances_.begin(), twist_covariances_.lower_bound(oldest_ns));
  return {};
}

PoseSource::Answer OdometryPoses::at(std::int64_t stamp_ns, const std::string& camera_frame) {
  const core::PoseBuffer::Answer pose = poses_.at(stamp_ns);
  if (pose.status != core::PoseBuffer::Status::kFound) return missing("odometry", pose.status);
  const std::string& base_frame = moved_frame_.empty() ? camera_frame : moved_frame_;
  const std::optional<core::SE3> T_base_camera = transforms_->find(base_frame, camera_frame, stamp_ns);
  if (!T_base_camera) {
    return {
        Status::kNotYet, {}, "tf has no transform from the odometry's '" + base_frame + "' to '" + camera_frame + "'"};
  }
  Answer answer = found(stamp_ns, pose.pose * *T_base_camera);
  answer.sample.covariance = step_covariance(stamp_ns, *T_base_camera);
  answer.sample.is_continuous = last_stamp_ns_ && poses_.is_continuous(*last_stamp_ns_, stamp_ns);
  return answer;
}

std::optional<core::Mat6> OdometryPoses::step_covariance(std::int64_t stamp_ns, const core::SE3& T_base_camera) const {
  const auto after = twist_covariances_.upper_bound(stamp_ns);
  if (!last_stamp_ns_ || after == twist_covariances_.begin() || !std::prev(after)->second) return std::nullopt;
  const double dt_s = 1e-9 * static_cast<double>(stamp_ns - *last_stamp_ns_);
  // Errors of a velocity last: a second's are the same however many images it has.
  constexpr double kLasting_s = 0.1;
  // Wheels that have not turned err by nothing that their turning errs by; hours of it would make any loop likely.
  constexpr double kStandingShare = 0.01;
  const core::PoseBuffer::Answer last = poses_.at(*last_stamp_ns_), now = poses_.at(stamp_ns);
  constexpr double kRounding = 1e-7;
  const bool stands = last.status == core::PoseBuffer::Status::kFound &&
                      (last.pose.t - now.pose.t).norm() < kRounding &&
                      core::rotation_angle(last.pose.q, now.pose.q) < kRounding;
  const double scale = (stands ? kStandingShare * kStandingShare : 1.0) * dt_s * std::max(dt_s, kLasting_s);
  const core::Mat6 carry = core::transport(T_base_camera);
  return core::Mat6(scale * carry * *std::prev(after)->second * carry.transpose());
}

}  // namespace semantic_topo_loop
