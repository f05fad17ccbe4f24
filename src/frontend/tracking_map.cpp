#include "frontend/tracking_map.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace semantic_topo_loop::core {

TrackingKeyframe& TrackingMap::add_keyframe(TrackingKeyframe keyframe) {
  const std::int64_t id = keyframe.id;
  keyframe.points.resize(keyframe.features.size(), -1);
  TrackingKeyframe& added = keyframes_.insert_or_assign(id, std::move(keyframe)).first->second;
  for (std::size_t i = 0; i < added.points.size(); ++i) {
    MapPoint* seen = point(added.points[i]);
    added.points[i] = -1;
    if (seen == nullptr) continue;
    add_view(seen, id, static_cast<int>(i));
    refresh(seen);
  }
  return added;
}

MapPoint& TrackingMap::add_point(const Vec3& position, std::int64_t keyframe, int feature) {
  MapPoint& added = points_[next_point_];
  added.id = next_point_++;
  added.position = position;
  added.first_keyframe = keyframe;
  add_view(&added, keyframe, feature);
  return added;
}

void TrackingMap::add_view(MapPoint* point, std::int64_t keyframe, int feature) {
  std::int64_t& there = keyframes_.at(keyframe).points[static_cast<std::size_t>(feature)];
  if (there >= 0 || !point->views.emplace(keyframe, feature).second) return;
  there = point->id;
}

void TrackingMap::remove_view(std::int64_t point, std::int64_t keyframe) {
  MapPoint& p = points_.at(point);
  const auto view = p.views.find(keyframe);
  if (view == p.views.end()) return;
  keyframes_.at(keyframe).points[static_cast<std::size_t>(view->second)] = -1;
  p.views.erase(view);
}

void TrackingMap::remove_point(std::int64_t point) {
  for (const auto& [keyframe, feature] : points_.at(point).views) {
    keyframes_.at(keyframe).points[static_cast<std::size_t>(feature)] = -1;
  }
  points_.erase(point);
}

void TrackingMap::remove_keyframe(std::int64_t keyframe) {
  const std::vector<std::int64_t> seen = keyframes_.at(keyframe).points;
  for (const std::int64_t id : seen) {
    if (id < 0) continue;
    remove_view(id, keyframe);
    MapPoint& p = points_.at(id);
    if (p.views.empty()) {
      points_.erase(id);
    } else {
      refresh(&p);
    }
  }
  keyframes_.erase(keyframe);
}

void TrackingMap::merge(std::int64_t from, std::int64_t into) {
  MapPoint& target = points_.at(into);
  const MapPoint source = points_.at(from);
  remove_point(from);
  for (const auto& [keyframe, feature] : source.views) add_view(&target, keyframe, feature);
  target.expected += source.expected;
  target.found += source.found;
  refresh(&target);
}

void TrackingMap::refresh(MapPoint* point) const {
  std::vector<const Descriptor*> descriptors;
  point->direction.setZero();
  double distance_m = 0.0;
  for (const auto& [id, feature] : point->views) {
    const TrackingKeyframe& keyframe = keyframes_.at(id);
    const auto index = static_cast<std::size_t>(feature);
    descriptors.push_back(&keyframe.features.descriptors[index]);
    const Vec3 ray = point->position - keyframe.center();
    point->direction += ray.normalized();
    distance_m += ray.norm() * std::pow(options_.scale_factor, keyframe.features.features[index].level);
  }
  point->direction.normalize();
  point->level_0_distance_m = distance_m / static_cast<double>(descriptors.size());
  int smallest = std::numeric_limits<int>::max();
  std::vector<int> distances(descriptors.size());
  for (const Descriptor* candidate : descriptors) {
    std::transform(descriptors.begin(), descriptors.end(), distances.begin(),
                   [candidate](const Descriptor* other) { return hamming(*candidate, *other); });
    const auto middle = distances.begin() + static_cast<std::ptrdiff_t>((distances.size() - 1) / 2);
    std::nth_element(distances.begin(), middle, distances.end());
    if (*middle >= smallest) continue;
    smallest = *middle;
    point->descriptor = *candidate;
  }
}

MapPoint* TrackingMap::point(std::int64_t id) {
  const auto found = points_.find(id);
  return found == points_.end() ? nullptr : &found->second;
}

TrackingKeyframe* TrackingMap::keyframe(std::int64_t id) {
  const auto found = keyframes_.find(id);
  return found == keyframes_.end() ? nullptr : &found->second;
}

std::vector<std::pair<std::int64_t, int>> TrackingMap::covisible(std::int64_t keyframe) const {
  std::vector<std::pair<std::int64_t, int>> all = covisible(keyframes_.at(keyframe).points);
  all.erase(std::remove_if(all.begin(), all.end(), [keyframe](const auto& entry) { return entry.first == keyframe; }),
            all.end());
  return all;
}

std::vector<std::pair<std::int64_t, int>> TrackingMap::covisible(const std::vector<std::int64_t>& points) const {
  std::map<std::int64_t, int> counts;
  for (const std::int64_t id : points) {
    const auto found = points_.find(id);
    if (found == points_.end()) continue;
    for (const auto& [keyframe, feature] : found->second.views) ++counts[keyframe];
  }
  std::vector<std::pair<std::int64_t, int>> sorted(counts.rbegin(), counts.rend());
  std::stable_sort(sorted.begin(), sorted.end(), [](const auto& a, const auto& b) { return a.second > b.second; });
  return sorted;
}

int TrackingMap::predict_level(const MapPoint& point, double distance_m) const {
  const double level = std::log(point.level_0_distance_m / distance_m) / std::log(options_.scale_factor);
  return static_cast<int>(std::lround(std::clamp(level, 0.0, options_.levels - 1.0)));
}

}  // namespace semantic_topo_loop::core
