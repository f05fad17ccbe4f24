#include <algorithm>
#include <cmath>
#include <set>

#include "frontend/tracking_map.h"
#include "geometry/wide_image.h"

namespace semantic_topo_loop::core {
namespace {

/// Points by their ids, which are asked for some ten thousand times an image.
class PointSet {
 public:
  explicit PointSet(const TrackingMap& map) : is_in_(static_cast<std::size_t>(map.next_point()), false) {}
  /// @param id -1: none   @return whether it is one, and new
  bool insert(std::int64_t id) {
    if (id < 0 || contains(id)) return false;
    is_in_[static_cast<std::size_t>(id)] = true;
    return true;
  }
  bool contains(std::int64_t id) const { return is_in_[static_cast<std::size_t>(id)]; }

 private:
  std::vector<bool> is_in_;
};

int trusted_inliers(const PoseEstimate& estimate, const std::vector<PoseObservation>& observations) {
  int count = 0;
  for (std::size_t i = 0; i < observations.size(); ++i) {
    count += observations[i].is_trusted && estimate.is_inlier[i] ? 1 : 0;
  }
  return count;
}

/// Fits the pose from `T_camera_map`; features that do not agree lose their point. New points have no say in it as long
/// as there are others: what moves by itself is never where it was for long.
bool fit(const SE3& T_camera_map, const Camera& camera, TrackingMap* map, TrackedFeatures* image) {
  constexpr int kProven = 4;  // the image that made the point, and three that found it: a tenth of a second
  std::vector<PoseObservation> observations;
  std::vector<std::size_t> features;
  for (std::size_t i = 0; i < image->points.size(); ++i) {
    const MapPoint* point = map->point(image->points[i]);
    if (point == nullptr) continue;
    observations.push_back(observation(image->features.features[i], *point));
    observations.back().is_trusted = point->found >= kProven;
    features.push_back(i);
  }
  image->matches = static_cast<int>(features.size());
  image->inliers = 0;
  std::optional<PoseEstimate> estimate = refine_pose(camera, T_camera_map, observations);
  const int proven = estimate ? trusted_inliers(*estimate, observations) : 0;
  if (proven < strong_inliers(map->options())) {
    std::vector<PoseObservation> all = observations;
    for (PoseObservation& o : all) o.is_trusted = true;
    std::optional<PoseEstimate> together = refine_pose(camera, T_camera_map, all);
    // What costs a proven point follows something that moves.
    const bool is_known = proven >= map->options().min_inliers / 2;
    if (!is_known || (together && trusted_inliers(*together, observations) >= proven)) estimate = std::move(together);
  }
  if (!estimate) return false;
  image->T_camera_map = estimate->T_camera_map;
  image->covariance = estimate->covariance;
  image->inliers = estimate->inliers;
  for (std::size_t k = 0; k < features.size(); ++k) {
    if (!estimate->is_inlier[k]) image->points[features[k]] = -1;
  }
  return true;
}

std::vector<std::int64_t> local_keyframes(const TrackingMap& map, const TrackedFeatures& image,
                                          const std::set<std::int64_t>* apart_from) {
  constexpr std::size_t kCovisible = 25, kMax = 45;  // bound the time of an image; 80 in ORB-SLAM
  constexpr double kNear_m = 1.0, kMinCosine = 0.7;  // 45 deg: half of what is seen from there is seen from here
  std::vector<std::int64_t> ids;
  for (const auto& [id, shared] : map.covisible(image.points)) {
    if (ids.size() < kCovisible && (apart_from == nullptr || apart_from->count(id) == 0)) ids.push_back(id);
  }
  if (apart_from != nullptr) return ids;
  // Places seen before are found again by where they are, long before anything in them is matched.
  const SE3 T_map_camera = image.T_camera_map.inverse();
  std::vector<std::pair<double, std::int64_t>> near;
  for (const auto& [id, keyframe] : map.keyframes()) {
    if (keyframe.section != image.section) continue;
    const double distance_m = (keyframe.center() - T_map_camera.t).norm();
    const Quaternion turn = image.T_camera_map.q * keyframe.T_camera_map.q.conjugate();
    const double cosine = (turn * Vec3::UnitZ()).z();
    if (distance_m < kNear_m && cosine > kMinCosine) near.emplace_back(distance_m + 1.0 - cosine, id);
  }
  std::sort(near.begin(), near.end());
  for (const auto& [distance, id] : near) {
    if (ids.size() >= kMax) break;
    if (std::find(ids.begin(), ids.end(), id) == ids.end()) ids.push_back(id);
  }
  return ids;
}

/// Where a point should be seen; nullopt if it is out of view.
std::optional<SearchItem> expect(const TrackingMap& map, const MapPoint& point, const SE3& T_camera_map,
                                 const Camera& camera) {
  constexpr double kMinCosine = 0.5;  // 60 deg, beyond which ORB's descriptor is another one (as in ORB-SLAM)
  constexpr double kRadius_px = 8.0;  // on level 0: ORB-SLAM2's for RGB-D are 7.5 to 12
  constexpr double kFarther = 1.3;    // than level 0 shows it alike: a level and a half of the pyramid
  const Vec3 p = T_camera_map * point.position;
  const std::optional<Vec2> pixel = pixel_in_view(camera, p);
  if (!pixel) return std::nullopt;
  const double distance_m = p.norm();
  if ((T_camera_map.q * point.direction).dot(p) < kMinCosine * distance_m) return std::nullopt;
  // Nearer or farther than any level of the pyramid shows it alike.
  const double farthest_m = kFarther * point.level_0_distance_m;
  const double nearest_m = farthest_m / map.scale_of(map.options().levels + TrackingMap::kBeyond);
  if (distance_m > farthest_m || distance_m < nearest_m) return std::nullopt;
  const int level = map.predict_level(point, distance_m);
  const double radius_px = kRadius_px * map.scale_of(level);
  return SearchItem{point.descriptor, *pixel, radius_px, level, -1.0F, point.id};
}

/// Looks for the points that are in view.
void match_points(const std::vector<const MapPoint*>& points, const TrackingMap& map, const Camera& camera,
                  TrackedFeatures* image) {
  std::vector<bool> is_taken(image->points.size());
  std::transform(image->points.begin(), image->points.end(), is_taken.begin(),
                 [](std::int64_t point) { return point >= 0; });
  std::vector<SearchItem> items;
  for (const MapPoint* point : points) {
    const std::optional<SearchItem> item = expect(map, *point, image->T_camera_map, camera);
    if (item) items.push_back(*item);
  }
  image->expected.clear();
  for (const SearchItem& item : items) image->expected.push_back(item.point);
  constexpr double kRatio = 0.8;  // stricter than for the last image's points, as in ORB-SLAM: there are more of them
  const std::vector<int> found = search(items, image->features, is_taken, kMatchBits, kRatio);
  for (std::size_t k = 0; k < items.size(); ++k) {
    if (found[k] >= 0) image->points[static_cast<std::size_t>(found[k])] = items[k].point;
  }
}

}  // namespace

bool follow_points(const TrackedFeatures& last, const SE3& T_camera_map, const Camera& camera, TrackingMap* map,
                   TrackedFeatures* image) {
  const FrontendOptions& options = map->options();
  // On level 0, as in ORB-SLAM: a turn that changes by 50 deg/s from one image to the next.
  constexpr double kRadius_px = 15.0;
  constexpr double kWider = 2.5;  // times, before the place is given up
  constexpr double kRatio = 0.9;  // of the best to the second best, as in ORB-SLAM
  for (const double factor : {1.0, kWider}) {
    std::vector<SearchItem> items;
    for (std::size_t i = 0; i < last.points.size(); ++i) {
      const MapPoint* point = map->point(last.points[i]);
      if (point == nullptr) continue;
      const std::optional<Vec2> pixel = pixel_in_view(camera, T_camera_map * point->position);
      if (!pixel) continue;
      const ImageFeature& feature = last.features.features[i];
      const double radius_px = factor * kRadius_px * pixel_factor(camera) * feature.scale;
      items.push_back({last.features.descriptors[i], *pixel, radius_px, feature.level, feature.angle_deg, point->id});
    }
    const std::vector<int> found =
        search(items, image->features, std::vector<bool>(image->features.size(), false), kMatchBits, kRatio);
    image->points.assign(image->features.size(), -1);
    int matches = 0;
    for (std::size_t k = 0; k < items.size(); ++k) {
      if (found[k] < 0) continue;
      image->points[static_cast<std::size_t>(found[k])] = items[k].point;
      ++matches;
    }
    if (matches < options.min_inliers) continue;
    // Enough to look for the rest of the map from there, which then must give min_inliers.
    if (fit(T_camera_map, camera, map, image) && image->inliers >= options.min_inliers / 2 &&
        3 * image->inliers >= image->matches) {
      return true;
    }
  }
  return false;
}

bool find_points(const TrackingKeyframe& keyframe, const Camera& camera, TrackingMap* map, TrackedFeatures* image) {
  const FrontendOptions& options = map->options();
  std::vector<bool> wanted(keyframe.points.size());
  std::transform(keyframe.points.begin(), keyframe.points.end(), wanted.begin(),
                 [](std::int64_t id) { return id >= 0; });
  constexpr double kMaxMotion_px = 240.0;  // half a 640 x 480 image's height; what moved farther has left many views
  const std::vector<int> matches =
      match_anywhere(keyframe.features, wanted, image->features, kMaxMotion_px * pixel_factor(camera));
  std::vector<PoseObservation> observations;
  std::vector<std::pair<std::size_t, std::int64_t>> pairs;
  for (std::size_t i = 0; i < matches.size(); ++i) {
    if (matches[i] < 0) continue;
    const auto feature = static_cast<std::size_t>(matches[i]);
    const MapPoint* point = map->point(keyframe.points[i]);
    observations.push_back(observation(image->features.features[feature], *point));
    pairs.emplace_back(feature, point->id);
  }
  const std::optional<PoseEstimate> estimate = find_pose(camera, observations, options.min_inliers / 2);
  if (!estimate) return false;
  image->points.assign(image->features.size(), -1);
  for (std::size_t k = 0; k < pairs.size(); ++k) {
    if (estimate->is_inlier[k]) image->points[pairs[k].first] = pairs[k].second;
  }
  image->T_camera_map = estimate->T_camera_map;
  image->section = keyframe.section;
  return true;
}

bool track_local_map(const Camera& camera, TrackingMap* map, TrackedFeatures* image,
                     const std::set<std::int64_t>* apart_from) {
  PointSet known(*map);
  for (const std::int64_t matched : image->points) known.insert(matched);
  std::vector<const MapPoint*> points;
  for (const std::int64_t id : local_keyframes(*map, *image, apart_from)) {
    for (const std::int64_t point : map->keyframe(id)->points) {
      if (known.insert(point)) points.push_back(map->point(point));
    }
  }
  match_points(points, *map, camera, image);
  return fit(image->T_camera_map, camera, map, image) && image->inliers >= map->options().min_inliers;
}

void count_views(const TrackedFeatures& image, TrackingMap* map) {
  PointSet found(*map);
  for (const std::int64_t id : image.points) {
    MapPoint* point = found.insert(id) ? map->point(id) : nullptr;
    if (point == nullptr) continue;
    ++point->found;
    ++point->expected;
  }
  for (const std::int64_t id : image.expected) {
    if (MapPoint* point = found.contains(id) ? nullptr : map->point(id)) ++point->expected;
  }
}

}  // namespace semantic_topo_loop::core
