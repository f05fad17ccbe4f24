#include "semantic_topo_loop/loop/loop_detector.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "semantic_topo_loop/loop/graph_detector.h"
#include "semantic_topo_loop/loop/local_map.h"
#include "semantic_topo_loop/loop/loop_options.h"
#include "semantic_topo_loop/loop/observation_window.h"
#include "semantic_topo_loop/loop/odometry_monitor.h"
#include "semantic_topo_loop/loop/paper_detector.h"
#include "semantic_topo_loop/loop/up_estimator.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::int64_t kSettleNs = 300'000'000;  ///< a jump may take several frames

}  // namespace

class LoopDetector::Impl {
 public:
  Impl(const LoopOptions& options, const ClassTable& classes)
      : enabled_(options.enabled),
        paper_mode_(options.mode == "paper"),
        attempt_interval_ns_(std::llround(1e9 * options.attempt_interval_s)),
        window_s_(options.window_s),
        min_window_s_(options.min_window_s),
        window_drift_rad_(radians(options.window_drift_deg)),
        window_(paper_mode_ ? options.paper_window_s : options.window_s, options.frame_interval_s, LabelTable(classes)),
        up_(options.up_window_s),
        builder_(options),
        graph_(options),
        paper_(options) {}

  void apply(const MapUpdate& update) {
    redirects_.apply(update);
    if (paper_mode_) paper_.apply(update);
  }

  std::vector<LoopClosure> detect(const Frame& frame, const AssociationFrame& associations) {
    if (frame.is_end) return {};
    if (frame.stamp_ns < settled_ns_) return {};
    const bool taken = window_.push(frame, associations);
    up_.push(frame);
    if (!paper_mode_) watch_odometry(frame, taken);
    if (!is_due(frame)) return {};
    std::optional<LocalMap> map = builder_.build(window_.frames(), redirects_, up_);
    if (!map) return {};
    if (paper_mode_) return paper_.detect(std::move(*map), enabled_);
    map->segment = segment_;
    map->drift_rad_s = monitor_.drift_rad_s().value_or(0.0);
    monitor_.set_reference(*map);
    std::vector<LoopClosure> loops;
    if (enabled_) loops = graph_.detect(*map);
    graph_.store(std::move(*map));
    return loops;
  }

  void set_enabled(bool enabled) { enabled_ = enabled; }

 private:
  /// Loops are looked for between keyframes too: a camera that hardly moves makes few of them, but every view of
  /// a known place shall be recognised at once.
  bool is_due(const Frame& frame) {
    const bool waited = frame.stamp_ns - last_attempt_ns_ >= attempt_interval_ns_;
    if (!frame.is_keyframe && !waited) return false;
    last_attempt_ns_ = frame.stamp_ns;
    return true;
  }

  /// A submap must not straddle a jump of the odometry, and spans less time the faster the odometry drifts.
  void watch_odometry(const Frame& frame, bool taken) {
    if (frame.is_break) {
      monitor_.restart();
      ++segment_;
    }
    if (taken && !window_.frames().empty() && monitor_.push(window_.frames().back())) {
      window_.clear();
      up_.clear();
      ++segment_;
      settled_ns_ = frame.stamp_ns + kSettleNs;
    }
    const std::optional<double> drift = monitor_.drift_rad_s();
    if (drift) window_.set_span(std::clamp(window_drift_rad_ / std::max(*drift, 1e-9), min_window_s_, window_s_));
  }

  bool enabled_;
  bool paper_mode_;
  std::int64_t attempt_interval_ns_;
  std::int64_t last_attempt_ns_ = 0;
  double window_s_, min_window_s_, window_drift_rad_;
  int segment_ = 0;
  std::int64_t settled_ns_ = 0;  ///< frames before are left out, after a jump
  ObservationWindow window_;
  OdometryMonitor monitor_;
  UpEstimator up_;
  LandmarkRedirects redirects_;
  LocalMapBuilder builder_;
  GraphDetector graph_;
  PaperDetector paper_;
};

LoopDetector::LoopDetector(const LoopOptions& options, std::shared_ptr<const ClassTable> classes)
    : impl_(std::make_unique<Impl>(options, *classes)) {}
LoopDetector::~LoopDetector() = default;
LoopDetector::LoopDetector(LoopDetector&&) noexcept = default;
LoopDetector& LoopDetector::operator=(LoopDetector&&) noexcept = default;

void LoopDetector::apply(const MapUpdate& update) { impl_->apply(update); }

std::vector<LoopClosure> LoopDetector::detect(const Frame& frame, const AssociationFrame& associations) {
  return impl_->detect(frame, associations);
}

void LoopDetector::set_enabled(bool enabled) { impl_->set_enabled(enabled); }

}  // namespace semantic_topo_loop::core
