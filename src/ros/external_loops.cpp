#include "ros/external_loops.h"

#include <iterator>
#include <string>
#include <tuple>
#include <utility>

#include "geometry/relative_pose.h"
#include "ros/conversions.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop {
namespace {

/// Between two keyframes the camera hardly moves, or it stands still for long.
constexpr double kForever_s = 1e9;
constexpr std::size_t kMaxWaiting = 100;  // more are of another clock

/// From errors about the axes of the parent to errors on the right, which is how the core has them.
core::Mat6 covariance_on_the_right(const core::Mat6& covariance, const core::SE3& T) {
  core::Mat6 turn = core::Mat6::Zero();
  turn.topLeftCorner<3, 3>() = turn.bottomRightCorner<3, 3>() = T.rotation().transpose();
  return turn * covariance * turn.transpose();
}

}  // namespace

ExternalLoops::ExternalLoops() : odometry_(kForever_s, kForever_s) {}

void ExternalLoops::add(const core::Frame& keyframe) {
  if (!odometry_.add(keyframe.stamp_ns, keyframe.T_odom_camera)) return;
  keyframes_[keyframe.stamp_ns] = {keyframe.keyframe_id, keyframe.frame_id};
}

std::vector<core::LoopClosure> ExternalLoops::take(const std::function<void(const std::string&)>& refuse) {
  using Status = core::PoseBuffer::Status;
  std::vector<core::LoopClosure> loops;
  for (const ExternalLoop::ConstPtr& message : std::exchange(waiting_, {})) {
    const std::int64_t query_ns = to_stamp_ns(message->header.stamp), match_ns = to_stamp_ns(message->match_stamp);
    const Place query = place(query_ns), match = place(match_ns);
    const std::string name =
        "external loop of stamps " + core::format_stamp(query_ns) + " and " + core::format_stamp(match_ns) + ": ";
    if (query.status == Status::kTooOld || match.status == Status::kTooOld) {
      refuse(name + "the session has no keyframe that is so old");
    } else if (query.status == Status::kNotYet || match.status == Status::kNotYet) {
      waiting_.push_back(message);
    } else if (core::Result<core::LoopClosure> loop = closure(query, match, message->match_from_query)) {
      loops.push_back(*std::move(loop));
    } else {
      refuse(name + loop.message());
    }
  }
  if (waiting_.size() > kMaxWaiting) {
    refuse(std::to_string(waiting_.size()) + " external loops have stamps newer than any keyframe");
    waiting_.clear();
  }
  return loops;
}

ExternalLoops::Place ExternalLoops::place(std::int64_t stamp_ns) const {
  const core::PoseBuffer::Answer answer = odometry_.at(stamp_ns);
  Place place;
  place.status = answer.status;
  if (answer.status != core::PoseBuffer::Status::kFound) return place;
  std::tie(place.stamp_ns, place.ids) = *std::prev(keyframes_.upper_bound(stamp_ns));
  place.T_keyframe_camera = odometry_.at(place.stamp_ns).pose.inverse() * answer.pose;
  return place;
}

core::Result<core::LoopClosure> ExternalLoops::closure(const Place& query, const Place& match,
                                                       const geometry_msgs::PoseWithCovariance& match_from_query) {
  if (query.ids.keyframe_id == match.ids.keyframe_id) return core::Error{"both are of one keyframe"};
  const core::Result<core::SE3> T_match_query = checked_pose(match_from_query.pose, "match_from_query.pose");
  if (!T_match_query) return T_match_query.error();
  const core::Mat6 given =
      Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(match_from_query.covariance.data());
  if (!core::is_covariance(given)) {
    return core::Error{"match_from_query.covariance is not finite, symmetric and positive definite"};
  }
  core::LoopClosure loop;
  loop.query_keyframe_id = query.ids.keyframe_id;
  loop.match_keyframe_id = match.ids.keyframe_id;
  loop.query_frame = loop.query_begin = loop.query_end = query.ids.frame_id;
  loop.match_frame = loop.match_begin = loop.match_end = match.ids.frame_id;
  loop.query_stamp_ns = query.stamp_ns;
  loop.match_stamp_ns = match.stamp_ns;
  loop.accepted = true;
  loop.reason = core::LoopReason::kFoundBySource;
  const core::SE3 T_camera_keyframe = query.T_keyframe_camera.inverse();
  loop.T_match_query = match.T_keyframe_camera * *T_match_query * T_camera_keyframe;
  const core::Mat6 carry = core::transport(T_camera_keyframe);
  loop.covariance = carry * covariance_on_the_right(given, *T_match_query) * carry.transpose();
  loop.state_sigmas(loop.covariance);
  return loop;
}

}  // namespace semantic_topo_loop
