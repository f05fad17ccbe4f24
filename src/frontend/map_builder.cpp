#include "frontend/map_builder.h"

#include <algorithm>
#include <cmath>

namespace semantic_topo_loop::core {
namespace {

constexpr std::size_t kNeighbours = 10;

int count_points(const TrackingMap& map, const std::vector<std::int64_t>& points, std::size_t min_views) {
  int count = 0;
  for (const std::int64_t id : points) {
    const auto found = map.points().find(id);
    count += found != map.points().end() && found->second.views.size() >= min_views ? 1 : 0;
  }
  return count;
}

}  // namespace

bool MapBuilder::needs_keyframe(const TrackedFeatures& image, const TrackingMap& map) const {
  constexpr double kTrackedShare = 0.8, kMinInterval_s = 0.12;
  const TrackingKeyframe& last = map.keyframes().rbegin()->second;
  const bool is_weak = image.inliers < 3 * options_.min_inliers;
  if (!is_weak && 1e-9 * static_cast<double>(image.stamp_ns - last.stamp_ns) < kMinInterval_s) return false;
  const std::vector<std::pair<std::int64_t, int>> covisible = map.covisible(image.points);
  if (covisible.empty()) return true;
  const std::size_t min_views = map.keyframes().size() > 2 ? 2 : 1;
  const int reference = count_points(map, map.keyframes().at(covisible.front().first).points, min_views);
  if (image.inliers < kTrackedShare * reference) return true;
  // Parts of the image with depth that the map has nothing of.
  int tracked = 0, untracked = 0;
  for (std::size_t i = 0; i < image.points.size(); ++i) {
    if (image.features.features[i].has_depth()) ++(image.points[i] >= 0 ? tracked : untracked);
  }
  return tracked < options_.features / 10 && untracked > options_.features / 14;
}

std::int64_t MapBuilder::add_keyframe(const TrackedFeatures& image, TrackingMap* map) const {
  TrackingKeyframe keyframe;
  keyframe.id = map->keyframes().empty() ? 0 : map->keyframes().rbegin()->first + 1;
  keyframe.stamp_ns = image.stamp_ns;
  keyframe.T_camera_map = image.T_camera_map;
  keyframe.features = image.features;
  keyframe.points = image.points;
  const std::int64_t id = map->add_keyframe(std::move(keyframe)).id;
  drop_points(id, map);
  add_points(id, map);
  fuse(id, map);
  drop_keyframes(id, map);
  return id;
}

void MapBuilder::add_points(std::int64_t id, TrackingMap* map) const {
  const TrackingKeyframe& keyframe = *map->keyframe(id);
  const SE3 T_map_camera = keyframe.T_camera_map.inverse();
  for (std::size_t i = 0; i < keyframe.features.size(); ++i) {
    const ImageFeature& feature = keyframe.features.features[i];
    if (keyframe.points[i] >= 0 || !feature.has_depth()) continue;
    const Vec3 position = T_map_camera * Vec3(feature.depth_m * camera_.ray(feature.pixel));
    map->refresh(&map->add_point(position, id, static_cast<int>(i)));
  }
}

void MapBuilder::fuse_into(const std::vector<std::int64_t>& points, std::int64_t id, TrackingMap* map) const {
  constexpr double kRadius_px = 3.0;
  constexpr int kSimilarBits = 50;
  TrackingKeyframe& keyframe = *map->keyframe(id);
  std::vector<SearchItem> items;
  std::vector<std::int64_t> ids;
  for (const std::int64_t point_id : points) {
    const MapPoint* point = map->point(point_id);
    if (point == nullptr || point->views.count(id) > 0) continue;
    const Vec3 p = keyframe.T_camera_map * point->position;
    if (p.z() < 0.1) continue;
    SearchItem item;
    item.pixel = Vec2(camera_.fx * p.x() / p.z() + camera_.cx, camera_.fy * p.y() / p.z() + camera_.cy);
    if (!(item.pixel.x() >= 0.0 && item.pixel.y() >= 0.0 && item.pixel.x() < camera_.width &&
          item.pixel.y() < camera_.height)) {
      continue;
    }
    item.descriptor = point->descriptor;
    item.level = map->predict_level(*point, p.norm());
    item.radius_px = kRadius_px * std::pow(options_.scale_factor, item.level);
    items.push_back(item);
    ids.push_back(point_id);
  }
  const std::vector<int> found =
      search(items, keyframe.features, std::vector<bool>(keyframe.features.size(), false), kSimilarBits, 1.0);
  for (std::size_t k = 0; k < items.size(); ++k) {
    if (found[k] < 0) continue;
    MapPoint* point = map->point(ids[k]);
    if (point == nullptr) continue;  // merged into another one meanwhile
    const ImageFeature& feature = keyframe.features.features[static_cast<std::size_t>(found[k])];
    const double depth_m = (keyframe.T_camera_map * point->position).z();
    constexpr double kGateSigmas = 3.0, kShare = 0.05;
    if (feature.has_depth() &&
        std::abs(feature.depth_m - depth_m) > kGateSigmas * feature.depth_sigma_m + kShare * depth_m) {
      continue;
    }
    const std::int64_t there = keyframe.points[static_cast<std::size_t>(found[k])];
    if (there < 0) {
      map->add_view(point, id, found[k]);
      map->refresh(point);
    } else {
      const bool keeps_other = map->point(there)->views.size() >= point->views.size();
      map->merge(keeps_other ? ids[k] : there, keeps_other ? there : ids[k]);
    }
  }
}

void MapBuilder::fuse(std::int64_t id, TrackingMap* map) const {
  std::vector<std::pair<std::int64_t, int>> neighbours = map->covisible(id);
  neighbours.resize(std::min(neighbours.size(), kNeighbours));
  for (const auto& [neighbour, shared] : neighbours) fuse_into(map->keyframe(id)->points, neighbour, map);
  std::vector<std::int64_t> around;
  for (const auto& [neighbour, shared] : neighbours) {
    const std::vector<std::int64_t>& points = map->keyframe(neighbour)->points;
    around.insert(around.end(), points.begin(), points.end());
  }
  std::sort(around.begin(), around.end());
  around.erase(std::unique(around.begin(), around.end()), around.end());
  fuse_into(around, id, map);
}

void MapBuilder::drop_points(std::int64_t newest, TrackingMap* map) const {
  constexpr std::int64_t kYoung = 3, kSettled = 8;  // keyframes since the point was made
  constexpr double kMinFoundShare = 0.25;
  std::vector<std::int64_t> dropped;
  for (const auto& [id, point] : map->points()) {
    const std::int64_t age = newest - point.first_keyframe;
    if (age > kSettled) continue;
    const bool is_rarely_found = point.found < kMinFoundShare * point.expected;
    const bool is_alone = age >= kYoung && point.views.size() < 2;
    if (is_rarely_found || is_alone) dropped.push_back(id);
  }
  for (const std::int64_t id : dropped) map->remove_point(id);
}

void MapBuilder::drop_keyframes(std::int64_t newest, TrackingMap* map) const {
  while (static_cast<int>(map->keyframes().size()) > options_.max_keyframes) {
    map->remove_keyframe(map->keyframes().begin()->first);
  }
  constexpr std::int64_t kRecent = 2;
  constexpr double kRedundantShare = 0.9;
  constexpr std::size_t kOthers = 4;
  for (const auto& [id, shared] : map->covisible(newest)) {
    if (newest - id <= kRecent || id == map->keyframes().begin()->first) continue;
    int seen = 0, redundant = 0;
    for (const std::int64_t point_id : map->keyframe(id)->points) {
      const MapPoint* point = map->point(point_id);
      if (point == nullptr) continue;
      ++seen;
      redundant += point->views.size() >= kOthers ? 1 : 0;
    }
    if (redundant > kRedundantShare * seen) map->remove_keyframe(id);
  }
}

}  // namespace semantic_topo_loop::core
