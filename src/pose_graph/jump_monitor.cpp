#include "semantic_topo_loop/pose_graph/jump_monitor.h"

#include <algorithm>

namespace semantic_topo_loop::core {
namespace {

constexpr std::size_t kReach = 10;     // frames on either side: a burst of less than that many does not move the median
constexpr std::size_t kHistory = 600;  // frames that say what is usual
constexpr std::size_t kMinHistory = 60;  // before that nothing is
constexpr double kSuspicious = 6.0;      // times the usual difference: beyond 99 % of the frames of a hand-held camera
constexpr double kCertain = 12.0;

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

void remember(double value, std::size_t turn, std::vector<double>* history) {
  if (history->size() < kHistory) {
    history->push_back(value);
  } else {
    (*history)[turn % kHistory] = value;
  }
}

}  // namespace

void JumpMonitor::add(const SE3& motion, double dt_s, std::size_t edge) {
  window_.push_back({se3_log(motion) / dt_s, dt_s, edge});
  if (window_.size() > 2 * kReach + 1) window_.pop_front();
  if (window_.size() == 2 * kReach + 1) judge(kReach);
}

void JumpMonitor::judge(std::size_t index) {
  Vec6 usual;
  for (int axis = 0; axis < 6; ++axis) {
    std::vector<double> values;
    for (const Motion& motion : window_) values.push_back(motion.rate(axis));
    usual(axis) = median(std::move(values));
  }
  const Motion& motion = window_[index];
  const Vec6 excess = motion.rate - usual;
  const double translation = excess.head<3>().norm(), rotation = excess.tail<3>().norm();
  if (suspects_.size() <= motion.edge) suspects_.resize(motion.edge + 1, Vec6::Zero());
  if (translations_.size() >= kMinHistory) {
    constexpr double kTiny = 1e-9;
    const double ratio =
        std::max(translation / (median(translations_) + kTiny), rotation / (median(rotations_) + kTiny));
    const double share = std::clamp((ratio - kSuspicious) / (kCertain - kSuspicious), 0.0, 1.0);
    suspects_[motion.edge] += share * motion.dt_s * excess;
  }
  remember(translation, next_, &translations_);
  remember(rotation, next_, &rotations_);
  ++next_;
}

void JumpMonitor::apply(std::vector<OdometryEdge>* edges) const {
  for (std::size_t i = 0; i < std::min(edges->size(), suspects_.size()); ++i) {
    (*edges)[i].suspect_translation_m = suspects_[i].head<3>().norm();
    (*edges)[i].suspect_rotation_rad = suspects_[i].tail<3>().norm();
  }
}

}  // namespace semantic_topo_loop::core
