#include "loop/submap/odometry_delay.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kMemory_s = 60.0;  ///< clocks drift apart by less than a millisecond in it
/// Half the time between two images of most cameras: who takes the pose of the nearest image is no later.
constexpr double kLeast_s = 0.015;
constexpr double kMost_s = 0.25;  ///< frames of a window, by which poses are shifted, are as far apart as half of it
constexpr double kEvidentSigmas = 4.0;

}  // namespace

void OdometryDelay::add(double seconds, double information, double elapsed_s) {
  if (!std::isfinite(seconds) || !(information > 0.0)) return;
  const double share = std::exp(-elapsed_s / kMemory_s);
  information_ = share * information_ + information;
  weighted_ = share * weighted_ + information * std::clamp(seconds, -kMost_s, kMost_s);
}

double OdometryDelay::seconds() const {
  if (!(information_ > 0.0)) return 0.0;
  const double mean_s = weighted_ / information_;
  return std::abs(mean_s) < std::max(kLeast_s, kEvidentSigmas / std::sqrt(information_)) ? 0.0 : mean_s;
}

std::string describe_delay(double delay_s) {
  if (delay_s == 0.0) return {};
  const long delay_ms = std::lround(1e3 * std::abs(delay_s));
  return "the odometry's poses come " + std::to_string(delay_ms) + (delay_s > 0.0 ? " ms late" : " ms early") +
         " against the images: taken into account for submaps and loops; stamps that agree serve objects and live "
         "poses too";
}

SE3 pose_at_image(const std::deque<ObservedFrame>& window, std::size_t frame, double delay_s) {
  if (delay_s == 0.0) return window[frame].T_odom_camera;
  const auto seconds_after = [&window, frame](std::size_t i) {
    return 1e-9 * static_cast<double>(window[i].stamp_ns - window[frame].stamp_ns);
  };
  std::size_t before = std::min(frame, window.size() - 2);
  while (before + 2 < window.size() && seconds_after(before + 1) <= delay_s) ++before;
  while (before > 0 && seconds_after(before) > delay_s) --before;
  const double begin_s = seconds_after(before), end_s = seconds_after(before + 1);
  return interpolate(window[before].T_odom_camera, window[before + 1].T_odom_camera,
                     (delay_s - begin_s) / (end_s - begin_s));
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
