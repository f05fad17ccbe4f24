#include "loop/graph/observation_window.h"

#include <algorithm>
#include <cmath>

namespace semantic_topo_loop::core {

void LandmarkRedirects::apply(const MapUpdate& update) {
  for (const LandmarkMerge& merge : update.unmerged) {
    const auto it = survivor_.find(merge.merged_id);
    if (it == survivor_.end() || it->second != merge.survivor_id) continue;
    std::vector<std::int64_t>& merged = merged_into_[merge.survivor_id];
    merged.erase(std::remove(merged.begin(), merged.end(), merge.merged_id), merged.end());
    survivor_.erase(it);
  }
  for (const LandmarkMerge& merge : update.merged) {
    if (resolve(merge.survivor_id) == merge.merged_id) continue;  // no id stands for itself by a detour
    if (survivor_.emplace(merge.merged_id, merge.survivor_id).second) {
      merged_into_[merge.survivor_id].push_back(merge.merged_id);
    }
  }
}

std::int64_t LandmarkRedirects::resolve(std::int64_t id) const {
  for (auto it = survivor_.find(id); it != survivor_.end(); it = survivor_.find(id)) id = it->second;
  return id;
}

std::vector<std::int64_t> LandmarkRedirects::aliases(std::int64_t id) const {
  std::vector<std::int64_t> ids = {resolve(id)};
  for (std::size_t i = 0; i < ids.size(); ++i) {
    const auto it = merged_into_.find(ids[i]);
    if (it != merged_into_.end()) ids.insert(ids.end(), it->second.begin(), it->second.end());
  }
  std::sort(ids.begin(), ids.end());
  return ids;
}

ObservationWindow::ObservationWindow(double span_s, double interval_s, LabelTable labels)
    : span_ns_(std::llround(1e9 * span_s)), interval_ns_(std::llround(1e9 * interval_s)), labels_(std::move(labels)) {}

bool ObservationWindow::push(const Frame& frame, const AssociationFrame& associations) {
  if (frame.is_break) {
    frames_.clear();
    tracker_.clear();
  }
  ObservedFrame observed = observe(frame, associations);
  const bool sampled = frames_.empty() || frame.stamp_ns - last_sampled_ns_ >= interval_ns_;
  if (sampled) last_sampled_ns_ = frame.stamp_ns;
  const bool taken = sampled || frame.is_keyframe;
  if (taken) frames_.push_back(std::move(observed));
  while (!frames_.empty() && frame.stamp_ns - frames_.front().stamp_ns > span_ns_) frames_.pop_front();
  return taken;
}

void ObservationWindow::set_span(double span_s) { span_ns_ = std::llround(1e9 * span_s); }

/// Every frame is followed, also those that are left out.
ObservedFrame ObservationWindow::observe(const Frame& frame, const AssociationFrame& associations) {
  const Camera& camera = frame.camera;
  ObservedFrame observed;
  observed.frame_id = frame.frame_id;
  observed.keyframe_id = frame.keyframe_id;
  observed.stamp_ns = frame.stamp_ns;
  observed.is_keyframe = frame.is_keyframe;
  observed.T_odom_camera = frame.T_odom_camera;
  observed.focal_px = Vec2(camera.fx, camera.fy);
  const auto normalised = [&camera](const Box& box) {
    const Vec3 low = camera.ray({box.x1, box.y1}), high = camera.ray({box.x2, box.y2});
    return Box{low.x(), low.y(), high.x(), high.y()};
  };
  observed.image = normalised({0.0, 0.0, static_cast<double>(camera.width), static_cast<double>(camera.height)});
  std::vector<TrackedBox> tracked;
  for (const Association& association : associations.associations) {
    if (association.landmark_id < 0 || !association.box.is_valid() || labels_.label(association.class_id) < 0) continue;
    tracked.push_back({normalised(association.box), association.class_id, association.score});
    observed.boxes.push_back({association.landmark_id, -1, -1, -1, tracked.back().box, association.truncated});
  }
  tracker_.follow(frame.stamp_ns, frame.T_odom_camera.q, &tracked);
  for (std::size_t i = 0; i < tracked.size(); ++i) {
    ObservedBox& box = observed.boxes[i];
    box.track_id = tracked[i].track_id;
    box.class_id = tracked[i].track_class_id;
    box.label = labels_.label(box.class_id);
  }
  return observed;
}

}  // namespace semantic_topo_loop::core
