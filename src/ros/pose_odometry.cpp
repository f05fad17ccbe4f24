#include "ros/pose_odometry.h"

#include <utility>

#include "geometry/relative_pose.h"
#include "ros/conversions.h"

namespace semantic_topo_loop {
namespace {

/// Drivers write 1e3 and more for "unknown".
constexpr double kLargestVariance = 1e2;

std::optional<core::Mat6> to_covariance(const boost::array<double, 36>& values) {
  const core::Mat6 covariance = Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(values.data());
  if (!core::is_covariance(covariance) || covariance.diagonal().maxCoeff() > kLargestVariance) return std::nullopt;
  return covariance;
}

}  // namespace

OdometryPoses::OdometryPoses(std::shared_ptr<TfPoses> transforms, double max_gap_s)
    : transforms_(std::move(transforms)), poses_(max_gap_s, kKeepPoses_s) {}

core::Status OdometryPoses::add(const nav_msgs::Odometry& message) {
  const core::Result<core::SE3> pose = checked_pose(message.pose.pose, "odometry pose");
  if (!pose) return pose.error();
  const std::int64_t stamp_ns = to_stamp_ns(message.header.stamp);
  if (!poses_.empty() && stamp_ns < poses_.newest_ns() - kJumpBack_ns) {
    poses_.clear();
    twist_covariances_.clear();
  }
  if (const core::Status added = poses_.add(stamp_ns, *pose); !added) return added.error();
  base_frame_ = strip_leading_slash(message.child_frame_id);
  if (const std::optional<core::Mat6> covariance = to_covariance(message.twist.covariance)) {
    twist_covariances_[stamp_ns] = *covariance;
    while (twist_covariances_.begin()->first < stamp_ns - static_cast<std::int64_t>(kKeepPoses_s * 1e9)) {
      twist_covariances_.erase(twist_covariances_.begin());
    }
  }
  return {};
}

PoseSource::Answer OdometryPoses::at(std::int64_t stamp_ns, const std::string& camera_frame) {
  Answer answer;
  answer.sample.stamp_ns = stamp_ns;
  const core::PoseBuffer::Answer pose = poses_.at(stamp_ns);
  if (pose.status != core::PoseBuffer::Status::kFound) {
    answer.problem = std::string("odometry: ") + describe(pose.status);
    if (pose.status != core::PoseBuffer::Status::kNotYet) answer.status = Status::kNever;
    return answer;
  }
  const std::string& base_frame = base_frame_.empty() ? camera_frame : base_frame_;
  const std::optional<core::SE3> T_base_camera = transforms_->find(base_frame, camera_frame, stamp_ns);
  if (!T_base_camera) {
    answer.problem = "tf has no transform from the odometry's '" + base_frame + "' to '" + camera_frame + "'";
    return answer;
  }
  answer.status = Status::kFound;
  answer.sample.T_odom_camera = pose.pose * *T_base_camera;
  answer.sample.covariance = step_covariance(stamp_ns, *T_base_camera);
  last_stamp_ns_ = stamp_ns;
  return answer;
}

std::optional<core::Mat6> OdometryPoses::step_covariance(std::int64_t stamp_ns, const core::SE3& T_base_camera) const {
  const auto after = twist_covariances_.upper_bound(stamp_ns);
  if (!last_stamp_ns_ || after == twist_covariances_.begin()) return std::nullopt;
  const double dt_s = 1e-9 * static_cast<double>(stamp_ns - *last_stamp_ns_);
  const core::Mat6 carry = core::transport(T_base_camera);
  return core::Mat6(dt_s * dt_s * carry * std::prev(after)->second * carry.transpose());
}

}  // namespace semantic_topo_loop
