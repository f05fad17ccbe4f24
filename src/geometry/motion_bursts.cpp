#include "semantic_topo_loop/geometry/motion_bursts.h"

#include <algorithm>

#include "semantic_topo_loop/geometry/statistics.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::size_t kReach = 10;     // frames on either side: a burst of less than that many does not move the median
constexpr std::size_t kHistory = 600;  // frames that say what is usual
constexpr std::size_t kMinHistory = 60;  // before that nothing is
constexpr double kSuspicious = 6.0;      // times the usual difference: beyond 99 % of the frames of a hand-held camera
constexpr double kCertain = 12.0;

void remember(double value, std::size_t turn, std::vector<double>* history) {
  if (history->size() < kHistory) {
    history->push_back(value);
  } else {
    (*history)[turn % kHistory] = value;
  }
}

}  // namespace

void MotionBursts::push(const StampedPose& pose, bool is_break, std::size_t section) {
  const std::optional<StampedPose> last = last_;
  last_ = pose;
  if (!last || is_break || pose.stamp_ns <= last->stamp_ns) return;
  const double dt_s = 1e-9 * static_cast<double>(pose.stamp_ns - last->stamp_ns);
  window_.push_back({se3_log(last->T_world_camera.inverse() * pose.T_world_camera) / dt_s,
                     pose.T_world_camera.q, dt_s, section});
  if (window_.size() > 2 * kReach + 1) window_.pop_front();
  if (window_.size() == 2 * kReach + 1) judge(kReach);
}

void MotionBursts::judge(std::size_t index) {
  Vec6 usual;
  for (int axis = 0; axis < 6; ++axis) {
    std::vector<double> values;
    for (const Motion& motion : window_) values.push_back(motion.rate(axis));
    usual(axis) = median(std::move(values));
  }
  const Motion& motion = window_[index];
  const Vec6 excess = motion.rate - usual;
  const double translation = excess.head<3>().norm(), rotation = excess.tail<3>().norm();
  if (suspects_.size() <= motion.section) suspects_.resize(motion.section + 1);
  if (translations_.size() >= kMinHistory) {
    constexpr double kTiny = 1e-9;
    const double ratio =
        std::max(translation / (median(translations_) + kTiny), rotation / (median(rotations_) + kTiny));
    const double share = std::clamp((ratio - kSuspicious) / (kCertain - kSuspicious), 0.0, 1.0);
    Suspect& suspect = suspects_[motion.section];
    const double time = share * motion.dt_s;
    suspect.motion.head<3>() += time * (motion.q_odom_camera * excess.head<3>());
    suspect.motion.tail<3>() += time * (motion.q_odom_camera * excess.tail<3>());
    suspect.error_m += time * median(translations_);
    suspect.error_rad += time * median(rotations_);
  }
  remember(translation, next_, &translations_);
  remember(rotation, next_, &rotations_);
  ++next_;
}

MotionBursts::Suspect MotionBursts::suspect(std::size_t section) const {
  return section < suspects_.size() ? suspects_[section] : Suspect();
}

}  // namespace semantic_topo_loop::core
