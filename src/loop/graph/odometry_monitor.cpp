#include "loop/graph/odometry_monitor.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "geometry/statistics.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kTolerance = 0.025;      ///< rad; boxes this close moved alike
constexpr double kMinJump = 0.045;        ///< rad; less does not spoil a submap
constexpr double kJumpFactor = 4.0;       ///< a jump exceeds the usual drift over the same time by it
constexpr double kMaxOffset = 0.6;        ///< rad; what moved farther is another object
constexpr double kMaxSizeRatio = 1.6;     ///< of detected and predicted box
constexpr int kMinSupport = 3;            ///< objects that a shift is told by
constexpr int kMinMore = 2;               ///< objects in place than without a jump: a single box may be off
constexpr std::size_t kMaxCompared = 40;  ///< objects and boxes of a frame: the time grows with the square of both
constexpr int kJumpFrames = 2;            ///< consecutive frames that show a jump
constexpr std::size_t kMaxRates = 200;    ///< some 20 s of frames at the default of loop.frame_interval_s
constexpr std::size_t kMinRates = 20;     ///< some 2 s

struct Prediction {
  int label;
  Vec2 center;
  double size;
};

/// Those that are largest in the image, by which a shift is told best; all where there are few.
template <class T, class Size>
std::vector<T> largest(std::vector<T> seen, Size size) {
  if (seen.size() <= kMaxCompared) return seen;
  std::stable_sort(seen.begin(), seen.end(), [&size](const T& p, const T& q) { return size(p) > size(q); });
  seen.resize(kMaxCompared, seen.front());
  return seen;
}

/// True if a detection of the label lies at the predicted place, moved by the offset.
bool is_supported(const Prediction& prediction, const Vec2& offset, const std::vector<ObservedBox>& boxes) {
  return std::any_of(boxes.begin(), boxes.end(), [&](const ObservedBox& box) {
    return box.label == prediction.label && (box.box.center() - prediction.center - offset).norm() < kTolerance;
  });
}

int support(const std::vector<Prediction>& predictions, const Vec2& offset, const std::vector<ObservedBox>& boxes) {
  return static_cast<int>(std::count_if(predictions.begin(), predictions.end(),
                                        [&](const Prediction& p) { return is_supported(p, offset, boxes); }));
}

/// The objects before the camera.
template <class Node>
std::vector<Prediction> predict(const std::vector<Node>& nodes, const SE3& T_odom_camera, double max_depth_m) {
  const SE3 T_camera_odom = T_odom_camera.inverse();
  std::vector<Prediction> predictions;
  for (const Node& node : nodes) {
    const Vec3 p = T_camera_odom * node.center;
    if (!(p.z() > node.radius) || p.z() > max_depth_m) continue;
    predictions.push_back({node.label, Vec2(p.x(), p.y()) / p.z(), 2.0 * node.radius / p.z()});
  }
  return largest(std::move(predictions), [](const Prediction& prediction) { return prediction.size; });
}

}  // namespace

void OdometryMonitor::set_reference(const LocalMap& map) {
  nodes_.clear();
  for (const LocalObject& object : map.objects) {
    nodes_.push_back({object.label, map.T_odom_anchor * object.spheroid.center, object.spheroid.radius()});
  }
  reference_ns_ = map.end_ns - std::llround(0.5e9 * map.span_s);
}

void OdometryMonitor::restart() {
  nodes_.clear();
  jumped_frames_ = 0;
}

bool OdometryMonitor::push(const ObservedFrame& frame) {
  const Shift shift = common_shift(frame);
  const double age_s = 1e-9 * static_cast<double>(frame.stamp_ns - reference_ns_);
  const bool is_in_place = shift.support <= 2 * shift.in_place;
  if (shift.support < kMinSupport || !(age_s > 0.0)) {
    if (is_in_place && shift.support > 0) jumped_frames_ = 0;  // few, but they speak against a jump
    return false;
  }
  const double usual = drift_rad_s().value_or(0.0) * age_s;
  const bool jumped = !is_in_place && shift.offset.norm() > std::max(kMinJump, kJumpFactor * usual);
  jumped_frames_ = jumped ? jumped_frames_ + 1 : 0;
  if (jumped_frames_ >= kJumpFrames) {
    restart();
    return true;
  }
  if (!jumped) rates_.push_back(shift.offset.norm() / age_s);
  if (rates_.size() > kMaxRates) rates_.pop_front();
  return false;
}

bool OdometryMonitor::refutes(const Vec6& jump, const ObservedFrame& frame) const {
  const auto in_place = [&](const SE3& T_odom_camera) {
    return support(predict(nodes_, T_odom_camera, max_depth_m_), Vec2::Zero(), frame.boxes);
  };
  const SE3 moved_back(so3_exp(-jump.tail<3>()) * frame.T_odom_camera.q, frame.T_odom_camera.t - jump.head<3>());
  return in_place(frame.T_odom_camera) >= in_place(moved_back) + kMinMore;
}

std::optional<double> OdometryMonitor::drift_rad_s() const {
  if (rates_.size() < kMinRates) return std::nullopt;
  return median({rates_.begin(), rates_.end()});
}

/// The offset between predicted and detected boxes of one label that most objects share; the smallest on ties.
OdometryMonitor::Shift OdometryMonitor::common_shift(const ObservedFrame& frame) const {
  const std::vector<Prediction> predictions = predict(nodes_, frame.T_odom_camera, max_depth_m_);
  const std::vector<ObservedBox> boxes =
      largest(frame.boxes, [](const ObservedBox& observed) { return observed.box.size(); });
  Shift best;
  for (const Prediction& prediction : predictions) {
    for (const ObservedBox& box : boxes) {
      const Vec2 offset = box.box.center() - prediction.center;
      const double ratio = box.box.size() / prediction.size;
      if (box.label != prediction.label || box.truncated != 0 || !(offset.norm() < kMaxOffset)) continue;
      if (ratio > kMaxSizeRatio || ratio < 1.0 / kMaxSizeRatio) continue;
      const int votes = support(predictions, offset, boxes);
      if (votes > best.support || (votes == best.support && offset.norm() < best.offset.norm())) {
        best.offset = offset;
        best.support = votes;
      }
    }
  }
  best.in_place = support(predictions, Vec2::Zero(), boxes);
  return best;
}

}  // namespace semantic_topo_loop::core
