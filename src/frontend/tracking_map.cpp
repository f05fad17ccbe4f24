#include "frontend/tracking_map.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace semantic_topo_loop::core {
namespace {

int count_points(const TrackingMap& map, const std::vector<std::int64_t>& points, std::size_t min_views) {
  int count = 0;
  for (const std::int64_t id : points) {
    const MapPoint* point = map.point(id);
    count += point != nullptr && point->views.size() >= min_views ? 1 : 0;
  }
  return count;
}

/// Whether a point stands where a keyframe before saw through.
bool has_come(const Vec3& position, const TrackingKeyframe& keyframe, const Camera& camera, const TrackingMap& map) {
  constexpr int kLooked = 20;  // keyframes: some seconds while something moves through the view, whose parts are new
  int looked = 0;
  for (auto it = map.keyframes().rbegin(); it != map.keyframes().rend() && looked < kLooked; ++it) {
    const TrackingKeyframe& before = it->second;
    if (before.id == keyframe.id || before.section.world != keyframe.section.world) continue;
    if (before.depth.sees_through(camera, before.T_camera_map * position)) return true;
    ++looked;
  }
  return false;
}

void add_points(std::int64_t id, const Camera& camera, TrackingMap* map) {
  const TrackingKeyframe& keyframe = *map->keyframe(id);
  const SE3 T_map_camera = keyframe.T_camera_map.inverse();
  for (std::size_t i = 0; i < keyframe.features.size(); ++i) {
    const ImageFeature& feature = keyframe.features.features[i];
    if (keyframe.points[i] >= 0 || !feature.has_depth()) continue;
    const Vec3 position = T_map_camera * Vec3(feature.depth_m * camera.ray(feature.pixel));
    if (has_come(position, keyframe, camera, *map)) continue;
    map->refresh(&map->add_point(position, id, static_cast<int>(i)));
  }
}

void fuse_into(const std::vector<std::int64_t>& points, std::int64_t id, const Camera& camera, TrackingMap* map) {
  constexpr double kRadius_px = 3.0;  // on level 0: two sigmas of a refined point's place, as in ORB-SLAM2's fusion
  TrackingKeyframe& keyframe = *map->keyframe(id);
  std::vector<SearchItem> items;
  for (const std::int64_t point_id : points) {
    const MapPoint* point = map->point(point_id);
    if (point == nullptr || point->views.count(id) > 0) continue;
    const Vec3 p = keyframe.T_camera_map * point->position;
    const std::optional<Vec2> pixel = pixel_in_view(camera, p);
    if (!pixel) continue;
    const int level = map->predict_level(*point, p.norm());
    const double radius_px = kRadius_px * map->scale_of(level);
    items.push_back({point->descriptor, *pixel, radius_px, level, -1.0F, point_id});
  }
  const std::vector<int> found =
      search(items, keyframe.features, std::vector<bool>(keyframe.features.size(), false), kSimilarBits, 1.0);
  for (std::size_t k = 0; k < items.size(); ++k) {
    if (found[k] < 0) continue;
    MapPoint* point = map->point(items[k].point);
    if (point == nullptr) continue;  // merged into another one meanwhile
    const ImageFeature& feature = keyframe.features.features[static_cast<std::size_t>(found[k])];
    const double depth_m = (keyframe.T_camera_map * point->position).z();
    constexpr double kGateSigmas = 3.0, kShare = 0.05;  // of the depth: what is nearer or farther is another surface
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
      map->merge(keeps_other ? items[k].point : there, keeps_other ? there : items[k].point);
    }
  }
}

/// One point where two keyframes made two.
void fuse(std::int64_t id, const Camera& camera, TrackingMap* map) {
  constexpr std::size_t kNeighbours = 10;  // as in ORB-SLAM2: those with fewer common points hold few that were missed
  std::vector<std::pair<std::int64_t, int>> neighbours = map->covisible(id);
  neighbours.resize(std::min(neighbours.size(), kNeighbours));
  for (const auto& [neighbour, shared] : neighbours) fuse_into(map->keyframe(id)->points, neighbour, camera, map);
  std::vector<std::int64_t> around;
  for (const auto& [neighbour, shared] : neighbours) {
    const std::vector<std::int64_t>& points = map->keyframe(neighbour)->points;
    around.insert(around.end(), points.begin(), points.end());
  }
  std::sort(around.begin(), around.end());
  around.erase(std::unique(around.begin(), around.end()), around.end());
  fuse_into(around, id, camera, map);
}

void drop_points(std::int64_t newest, TrackingMap* map) {
  // Keyframes since the point was made, and the share of the images that should show it: of ORB-SLAM's order.
  constexpr std::int64_t kYoung = 3, kSettled = 8;
  constexpr double kMinFoundShare = 0.25;
  const std::int64_t world = map->keyframe(newest)->section.world;
  for (std::int64_t id = map->next_point() - 1; id >= 0; --id) {
    const MapPoint* point = map->point(id);
    if (point == nullptr) continue;
    const std::int64_t age = newest - point->first_keyframe;
    if (age > kSettled) break;  // and those before are older
    const bool is_rarely_found = point->found < kMinFoundShare * point->expected;
    // The images after a loss show nothing of what was there before.
    const bool could_be_seen = map->keyframe(point->views.begin()->first)->section.world == world;
    const bool is_alone = age >= kYoung && point->views.size() < 2 && could_be_seen;
    if (is_rarely_found || is_alone) map->remove_point(id);
  }
}

void drop_keyframes(std::int64_t newest, TrackingMap* map) {
  while (static_cast<int>(map->keyframes().size()) > map->options().max_keyframes) {
    map->remove_keyframe(map->keyframes().begin()->first);
  }
  // As in ORB-SLAM: nine tenths of a redundant keyframe's points are seen by three others as well.
  constexpr double kRedundantShare = 0.9;
  constexpr std::size_t kViews = 4;
  constexpr std::int64_t kRecent = 2;  // keyframes, which the next images hang on
  for (const auto& [id, shared] : map->covisible(newest)) {
    if (newest - id <= kRecent || id == map->keyframes().begin()->first) continue;
    int seen = 0, redundant = 0;
    for (const std::int64_t point_id : map->keyframe(id)->points) {
      const MapPoint* point = map->point(point_id);
      if (point == nullptr) continue;
      ++seen;
      redundant += point->views.size() >= kViews ? 1 : 0;
    }
    if (redundant > kRedundantShare * seen) map->remove_keyframe(id);
  }
}

}  // namespace

PoseObservation observation(const ImageFeature& feature, const MapPoint& point) {
  return {point.position, feature.pixel, feature.scale, feature.depth_m, feature.depth_sigma_m};
}

TrackingMap::TrackingMap(const FrontendOptions& options) : options_(options) {
  for (int level = 0; level < options.levels + kBeyond + 1; ++level) {
    scales_.push_back(std::pow(options.scale_factor, level));
  }
}

TrackingKeyframe& TrackingMap::add_keyframe(TrackingKeyframe keyframe) {
  const std::int64_t id = keyframe.id;
  keyframe.points.resize(keyframe.features.size(), -1);
  TrackingKeyframe& added = keyframes_.insert_or_assign(id, std::move(keyframe)).first->second;
  words_.insert(static_cast<int>(id), visual_words(added.features.descriptors));
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
  words_.erase(static_cast<int>(keyframe), visual_words(keyframes_.at(keyframe).features.descriptors));
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

void TrackingMap::join(const MapSection& from, const MapSection& into, const SE3& T_into_from) {
  for (auto& [id, point] : points_) {
    if (keyframes_.at(point.views.begin()->first).section != from) continue;
    point.position = T_into_from * point.position;
    point.direction = T_into_from.q * point.direction;
  }
  const SE3 T_from_into = T_into_from.inverse();
  for (auto& [id, keyframe] : keyframes_) {
    if (keyframe.section != from) continue;
    keyframe.T_camera_map = keyframe.T_camera_map * T_from_into;
    keyframe.section = into;
  }
}

void TrackingMap::refresh_geometry(MapPoint* point) const {
  point->direction.setZero();
  double distance_m = 0.0;
  for (const auto& [id, feature] : point->views) {
    const TrackingKeyframe& keyframe = keyframes_.at(id);
    const Vec3 ray = point->position - keyframe.center();
    point->direction += ray.normalized();
    distance_m += ray.norm() * keyframe.features.features[static_cast<std::size_t>(feature)].scale;
  }
  point->direction.normalize();
  point->level_0_distance_m = distance_m / static_cast<double>(point->views.size());
}

void TrackingMap::refresh(MapPoint* point) const {
  refresh_geometry(point);
  std::vector<const Descriptor*> descriptors;
  for (const auto& [id, feature] : point->views) {
    descriptors.push_back(&keyframes_.at(id).features.descriptors[static_cast<std::size_t>(feature)]);
  }
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

const MapPoint* TrackingMap::point(std::int64_t id) const {
  if (id < 0) return nullptr;  // of most features, without a search
  const auto found = points_.find(id);
  return found == points_.end() ? nullptr : &found->second;
}

MapPoint* TrackingMap::point(std::int64_t id) { return const_cast<MapPoint*>(std::as_const(*this).point(id)); }

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
  if (keyframes_.empty()) return {};
  const std::int64_t first = keyframes_.begin()->first, last = keyframes_.rbegin()->first;
  std::vector<int> counts(static_cast<std::size_t>(last - first + 1), 0);
  for (const std::int64_t id : points) {
    const MapPoint* seen = point(id);
    if (seen == nullptr) continue;
    for (const auto& [keyframe, feature] : seen->views) ++counts[static_cast<std::size_t>(keyframe - first)];
  }
  std::vector<std::pair<std::int64_t, int>> sorted;
  for (std::int64_t id = last; id >= first; --id) {
    const int count = counts[static_cast<std::size_t>(id - first)];
    if (count > 0) sorted.emplace_back(id, count);
  }
  std::stable_sort(sorted.begin(), sorted.end(), [](const auto& a, const auto& b) { return a.second > b.second; });
  return sorted;
}

int TrackingMap::predict_level(const MapPoint& point, double distance_m) const {
  const double level = std::log(point.level_0_distance_m / distance_m) / std::log(options_.scale_factor);
  return static_cast<int>(std::lround(std::clamp(level, 0.0, options_.levels - 1.0)));
}

bool needs_keyframe(const TrackedFeatures& image, const TrackingMap& map) {
  constexpr double kTrackedShare = 0.8;    // of the points of the keyframe with most common ones
  constexpr double kMinInterval_s = 0.12;  // about four images of 30 Hz: nearer ones show the same
  // ORB-SLAM2's: of 1000 features fewer than 100 tracked with depth while more than 70 others have depth.
  const int few_tracked = map.options().features / 10, many_untracked = map.options().features / 14;
  const TrackingKeyframe& last = map.keyframes().rbegin()->second;
  const bool is_weak = image.inliers < strong_inliers(map.options());
  if (!is_weak && 1e-9 * static_cast<double>(image.stamp_ns - last.stamp_ns) < kMinInterval_s) return false;
  const std::vector<std::pair<std::int64_t, int>> covisible = map.covisible(image.points);
  if (covisible.empty()) return true;
  const auto is_here = [&image](const auto& entry) { return entry.second.section == image.section; };
  const std::size_t min_views = std::count_if(map.keyframes().begin(), map.keyframes().end(), is_here) > 2 ? 2 : 1;
  const int reference = count_points(map, map.keyframes().at(covisible.front().first).points, min_views);
  if (image.inliers < kTrackedShare * reference) return true;
  // Parts of the image with depth that the map has nothing of.
  int tracked = 0, untracked = 0;
  for (std::size_t i = 0; i < image.points.size(); ++i) {
    if (image.features.features[i].has_depth()) ++(image.points[i] >= 0 ? tracked : untracked);
  }
  return tracked < few_tracked && untracked > many_untracked;
}

std::int64_t add_keyframe(const TrackedFeatures& image, const std::vector<Vec3>& points_camera, const Camera& camera,
                          TrackingMap* map) {
  const std::int64_t id = map->keyframes().empty() ? 0 : map->keyframes().rbegin()->first + 1;
  map->add_keyframe({{id, image.stamp_ns, image.T_camera_map, image.section, image.features, image.points},
                     NearestDepth(camera, points_camera),
                     image.T_camera_map.inverse()});
  drop_points(id, map);
  add_points(id, camera, map);
  fuse(id, camera, map);
  drop_keyframes(id, map);
  return id;
}

}  // namespace semantic_topo_loop::core
