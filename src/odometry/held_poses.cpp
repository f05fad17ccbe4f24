#include "odometry/held_poses.h"

#include <algorithm>
#include <cstddef>
#include <utility>
#include <vector>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

/// But for rounding, by which poses differ that tf interpolates.
bool is_same(const SE3& a, const SE3& b) {
  constexpr double kRounding = 1e-12;  // m, and of a quaternion
  return (a.t - b.t).cwiseAbs().maxCoeff() < kRounding &&
         (a.q.coeffs() - b.q.coeffs()).cwiseAbs().maxCoeff() < kRounding;
}
double seconds(std::int64_t begin_ns, std::int64_t end_ns) { return 1e-9 * static_cast<double>(end_ns - begin_ns); }

}  // namespace

SE3 pose_on_the_way(std::int64_t stamp_ns, const SE3& T_odom_camera, const Frame& later) {
  if (!later.held_since_ns || stamp_ns <= *later.held_since_ns || stamp_ns >= later.stamp_ns) return T_odom_camera;
  // Messages may hold any stamp: unsigned differences do not overflow.
  const auto since_held = [&later](std::int64_t stamp) {
    return static_cast<double>(static_cast<std::uint64_t>(stamp) - static_cast<std::uint64_t>(*later.held_since_ns));
  };
  return interpolate(T_odom_camera, later.T_odom_camera, since_held(stamp_ns) / since_held(later.stamp_ns));
}

bool HeldPoses::is_held(std::int64_t stamp_ns, const SE3& T_odom_camera) {
  constexpr std::size_t kRemembered = 20;  // poses
  constexpr double kStanding_s = 1.0;      // for so long the camera stood, or the odometry was lost
  constexpr std::size_t kLate = 2;         // times what is usual
  if (!image_ || !is_same(image_->T_odom_camera, T_odom_camera)) {
    if (image_ && seconds(image_->since_ns, stamp_ns) < kStanding_s) repeated_.push_back(image_->repeated);
    if (repeated_.size() > kRemembered) repeated_.pop_front();
    image_ = {T_odom_camera, stamp_ns, 0};
    return false;
  }
  ++image_->repeated;
  if (repeated_.empty()) return false;
  std::vector<std::size_t> counts(repeated_.begin(), repeated_.end());
  const auto usual = counts.begin() + static_cast<std::ptrdiff_t>(counts.size() / 2);
  std::nth_element(counts.begin(), usual, counts.end());
  return image_->repeated <= kLate * *usual;
}

HeldPoses::Motion HeldPoses::move(std::int64_t stamp_ns, const SE3& T_odom_camera) {
  constexpr double kLongest_s = 2.0;  // who was lost for longer knows the way by chance at most
  constexpr double kRecent_s = 1.0;
  constexpr double kSudden = 3.0;  // times the fastest of late: a hand's or robot's next motion is not
  constexpr double kLeast_m = 0.03, kLeast_rad = 0.03;
  constexpr Speed kSlowest{0, 0.1, 0.2};  // a camera that stood may move so at once
  const std::optional<Pose> last = std::exchange(last_, Pose{stamp_ns, T_odom_camera, stamp_ns});
  if (!last || stamp_ns <= last->stamp_ns) return {};
  if (is_same(last->T_odom_camera, T_odom_camera)) {
    last_->since_ns = last->since_ns;
    return {};
  }
  Speed fastest = kSlowest;
  for (const Speed& speed : speeds_) {
    fastest.translation_mps = std::max(fastest.translation_mps, speed.translation_mps);
    fastest.rotation_radps = std::max(fastest.rotation_radps, speed.rotation_radps);
  }
  const double distance_m = (T_odom_camera.t - last->T_odom_camera.t).norm();
  const double angle_rad = rotation_angle(T_odom_camera.q, last->T_odom_camera.q);
  const double frame_s = seconds(last->stamp_ns, stamp_ns), stood_s = seconds(last->since_ns, stamp_ns);
  const double limit_mps = kSudden * fastest.translation_mps, limit_radps = kSudden * fastest.rotation_radps;
  const bool is_sudden =
      distance_m > std::max(kLeast_m, limit_mps * frame_s) || angle_rad > std::max(kLeast_rad, limit_radps * frame_s);
  Motion motion;
  motion.is_way = stood_s < kLongest_s && distance_m < limit_mps * stood_s && angle_rad < limit_radps * stood_s;
  const bool has_caught_up = last->since_ns < last->stamp_ns && is_sudden && motion.is_way;
  const double time_s = has_caught_up ? stood_s : frame_s;
  while (!speeds_.empty() && seconds(speeds_.front().stamp_ns, stamp_ns) > kRecent_s + stood_s) speeds_.pop_front();
  if (time_s < kRecent_s) speeds_.push_back({stamp_ns, distance_m / time_s, angle_rad / time_s});
  if (has_caught_up) motion.caught_up_since_ns = last->since_ns;
  return motion;
}

void HeldPoses::begin_anew() {
  speeds_.clear();
  if (last_) last_->since_ns = last_->stamp_ns;
}

}  // namespace semantic_topo_loop::core
