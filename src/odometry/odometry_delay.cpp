#include "odometry/odometry_delay.h"

#include <algorithm>
#include <cmath>

namespace semantic_topo_loop::core {
namespace {

/// What clocks drift apart, s after a root second: 2 ms in a minute.
constexpr double kWander_s = 0.00026;
/// Half the time between two images of most cameras: who takes the pose of the nearest image is no later.
constexpr double kLeast_s = 0.015;
constexpr double kEvidentSigmas = 4.0;
constexpr double kStay = 0.5;     ///< of both: a delay that was evident stays so down to there
constexpr double kUsual_s = 0.1;  ///< sigma of what is not known yet
constexpr double kMost_s = 0.25;  ///< poses are taken from other images of a window, not from anywhere

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

}  // namespace semantic_topo_loop::core
