#include "semantic_topo_loop/loop/loop_detector.h"

#include <map>

#include "semantic_topo_loop/loop/graph_detector.h"
#include "semantic_topo_loop/loop/local_map.h"
#include "semantic_topo_loop/loop/loop_options.h"
#include "semantic_topo_loop/loop/observation_window.h"
#include "semantic_topo_loop/loop/paper_detector.h"
#include "semantic_topo_loop/loop/up_estimator.h"

namespace semantic_topo_loop::core {

class LoopDetector::Impl {
 public:
  Impl(const LoopOptions& options, const ClassTable& classes)
      : enabled_(options.enabled),
        paper_mode_(options.mode == "paper"),
        window_(paper_mode_ ? options.paper_window_s : options.window_s, options.frame_interval_s, LabelTable(classes)),
        up_(options.up_window_s),
        builder_(options),
        graph_(options),
        paper_(options) {}

  void apply(const MapUpdate& update) {
    for (const LandmarkMerge& merge : update.merged) redirects_.add(merge);
    if (paper_mode_) paper_.apply(update);
  }

  std::vector<LoopClosure> detect(const Frame& frame, const AssociationFrame& associations) {
    if (frame.is_end) return {};
    window_.push(frame, associations);
    up_.push(frame);
    if (!frame.is_keyframe) return {};
    std::optional<LocalMap> map = builder_.build(window_.frames(), redirects_, up_);
    if (!map) return {};
    if (paper_mode_) return paper_.detect(std::move(*map), enabled_);
    std::vector<LoopClosure> loops;
    if (enabled_) loops = graph_.detect(*map);
    graph_.store(std::move(*map));
    return loops;
  }

  void set_enabled(bool enabled) { enabled_ = enabled; }

 private:
  bool enabled_;
  bool paper_mode_;
  ObservationWindow window_;
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
