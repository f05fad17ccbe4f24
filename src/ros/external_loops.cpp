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

constexpr double kForever_s = 1e9;        // a session's frames are forgotten at its end
constexpr std::size_t kMaxWaiting = 100;  // more are of another clock

/// From errors about the axes of the parent to errors on the right, which is how the core has them.
core::Mat6 covariance_on_the_right(const core::Mat6& covariance, const core::SE3& T) {
  core::Mat6 turn = core::Mat6::Zero();
  turn.topLeftCorner<3, 3>() = turn.bottomRightCorner<3, 3>() = T.rotation().transpose();
  return turn * covariance * turn.transpose();
}

std::string name_of(const ExternalLoop& loop) {
  return "external loop of stamps " + core::format_stamp(to_stamp_ns(loop.header.stamp)) + " and " +
         core::format_stamp(to_stamp_ns(loop.match_stamp)) + ": ";
}

}  // namespace

ExternalLoops::Section::Section() : odometry(kForever_s, kForever_s) {}

void ExternalLoops::add(const core::Frame& frame) {
  if (frame.is_end) return;
  if (sections_.empty() || frame.is_break) sections_.try_emplace(frame.stamp_ns);
  Section& section = std::prev(sections_.end())->second;
  if (!section.odometry.add(frame.stamp_ns, frame.T_odom_camera) || !frame.is_keyframe) return;
  section.keyframes[frame.stamp_ns] = {frame.keyframe_id, frame.frame_id};
}

std::vector<core::LoopClosure> ExternalLoops::take() {
  using Status = core::PoseBuffer::Status;
  std::vector<core::LoopClosure> loops;
  for (const ExternalLoop::ConstPtr& message : std::exchange(waiting_, {})) {
    const Place query = place(to_stamp_ns(message->header.stamp)), match = place(to_stamp_ns(message->match_stamp));
    const auto either_is = [&](Status status) { return query.status == status || match.status == status; };
    if (either_is(Status::kTooOld)) {
      refuse_(name_of(*message) + "the session has no keyframe that is so old");
    } else if (either_is(Status::kGap)) {
      refuse_(name_of(*message) + "one of its images lies in a break of the odometry");
    } else if (either_is(Status::kNotYet)) {
      waiting_.push_back(message);
    } else if (core::Result<core::LoopClosure> loop = closure(query, match, message->match_from_query)) {
      loops.push_back(*std::move(loop));
    } else {
      refuse_(name_of(*message) + loop.message());
    }
  }
  if (waiting_.size() > kMaxWaiting) refuse_waiting("newer than any frame, as too many others are");
  return loops;
}

void ExternalLoops::end() {
  refuse_waiting("the session has ended without such a frame");
  sections_.clear();
}

void ExternalLoops::refuse_waiting(const std::string& why) {
  for (const ExternalLoop::ConstPtr& message : std::exchange(waiting_, {})) refuse_(name_of(*message) + why);
}

ExternalLoops::Place ExternalLoops::place(std::int64_t stamp_ns) const {
  using Status = core::PoseBuffer::Status;
  Place place;
  if (sections_.empty()) return place;
  const auto next = sections_.upper_bound(stamp_ns);
  place.status = Status::kTooOld;
  if (next == sections_.begin()) return place;
  const Section& section = std::prev(next)->second;
  const auto next_keyframe = section.keyframes.upper_bound(stamp_ns);
  if (next_keyframe == section.keyframes.begin()) return place;
  const core::PoseBuffer::Answer answer = section.odometry.at(stamp_ns);
  place.status = answer.status == Status::kNotYet && next != sections_.end() ? Status::kGap : answer.status;
  if (place.status != Status::kFound) return place;
  std::tie(place.stamp_ns, place.ids) = *std::prev(next_keyframe);
  place.T_keyframe_camera = section.odometry.at(place.stamp_ns).pose.inverse() * answer.pose;
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
