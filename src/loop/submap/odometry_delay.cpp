#include "loop/submap/odometry_delay.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

/// What clocks drift apart, s after a root second: 2 ms in a minute.
constexpr double kWander_s = 0.00026;
/// Half the time between two images of most cameras: who takes the pose of the nearest image is no later.
constexpr double kLeast_s = 0.015;
constexpr double kEvidentSigmas = 4.0;
constexpr double kStay = 0.5;            ///< of both: a delay that was evident stays so down to there
constexpr double kUsual_s = 0.1;         ///< sigma of what is not known yet
constexpr double kMost_s = 0.25;         ///< poses are taken from other images of a window, not from anywhere
constexpr double kMinBaseline_s = 0.05;  ///< over which a motion goes on; closer frames' jitter would grow

}  // namespace

void OdometryDelay::add(double seconds, double information, double elapsed_s) {
  if (information_ > 0.0) information_ = 1.0 / (1.0 / information_ + kWander_s * kWander_s * elapsed_s);
  if (!std::isfinite(seconds) || !(information > 0.0)) return;
  information_ += information;
  mean_s_ += information / information_ * (std::clamp(seconds, -kMost_s, kMost_s) - mean_s_);
  const double least_s = std::max(kLeast_s, kEvidentSigmas / std::sqrt(information_));
  is_evident_ = std::abs(mean_s_) >= (is_evident_ ? kStay : 1.0) * least_s;
}

double OdometryDelay::sigma_s() const { return 1.0 / std::sqrt(information_ + 1.0 / (kUsual_s * kUsual_s)); }

std::string describe_delay(double delay_s) {
  if (delay_s == 0.0) return {};
  const bool is_most = std::abs(delay_s) > 0.98 * kMost_s;
  const std::string delay_ms = std::to_string(std::lround(1e3 * std::abs(delay_s)));
  return "the odometry's poses come " + delay_ms + (is_most ? " ms or more" : " ms") +
         (delay_s > 0.0 ? " late" : " early") +
         " against the images: taken into account for submaps and loops; stamps that agree serve objects and live "
         "poses too";
}

SE3 pose_at_image(const std::deque<ObservedFrame>& window, std::size_t frame, double delay_s) {
  if (delay_s == 0.0) return window[frame].T_odom_camera;
  const auto seconds_after = [&window, frame](std::size_t i) {
    return 1e-9 * static_cast<double>(window[i].stamp_ns - window[frame].stamp_ns);
  };
  std::size_t after = 1;
  while (after + 1 < window.size() && seconds_after(after) <= delay_s) ++after;
  std::size_t before = after - 1;
  const auto is_short = [&] { return seconds_after(after) - seconds_after(before) < kMinBaseline_s; };
  while (before > 0 && seconds_after(after) < delay_s && is_short()) --before;
  while (after + 1 < window.size() && seconds_after(before) > delay_s && is_short()) ++after;
  const double begin_s = seconds_after(before), span_s = seconds_after(after) - begin_s;
  if (!(span_s > 0.0)) return window[frame].T_odom_camera;
  return interpolate(window[before].T_odom_camera, window[after].T_odom_camera, (delay_s - begin_s) / span_s);
}

std::deque<ObservedFrame> undelayed(std::deque<ObservedFrame> window, double delay_s) {
  if (delay_s == 0.0) return window;
  std::vector<SE3> T_odom_camera;
  T_odom_camera.reserve(window.size());
  for (std::size_t i = 0; i < window.size(); ++i) T_odom_camera.push_back(pose_at_image(window, i, delay_s));
  for (std::size_t i = 0; i < window.size(); ++i) window[i].T_odom_camera = T_odom_camera[i];
  return window;
}

}  // namespace semantic_topo_loop::core
