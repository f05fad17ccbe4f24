#include "loop/submap/submap_builder.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <numeric>
#include <set>
#include <utility>

#include "geometry/statistics.h"
#include "loop/submap/feature_alignment.h"
#include "loop/submap/ray_clusters.h"
#include "loop/submap/spheroid.h"
#include "loop/submap/surfels.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kCheckFrames = 10;  ///< in which another submap's objects are looked for: one in 1.5 s of the longest
constexpr double kMaxFitShift_m = 0.2;   ///< a fit that leaves its rays this far is refused
constexpr double kDuplicateShare = 0.6;  ///< of the mean radius, between two objects' centres
constexpr double kMinRadius_m = 0.03;    ///< for that: the centres of small objects are not known better
constexpr double kViewMargin = 0.1;      ///< of the image, in which an object does not count as in view

LocalFrame make_frame(const ObservedFrame& observed, const SE3& T_anchor_odom) {
  const SE3 T_local_camera = T_anchor_odom * observed.T_odom_camera;
  LocalFrame frame;
  frame.frame_id = observed.frame_id;
  frame.R_camera_local = T_local_camera.rotation().transpose();
  frame.position = T_local_camera.t;
  frame.t_camera_local = -frame.R_camera_local * frame.position;
  frame.focal_px = observed.focal_px;
  frame.image = observed.image;
  return frame;
}

/// Where the unit of length is free, the odometry is one without depth.
bool uses_depth(const LoopOptions& options) { return options.use_points && options.scale == "fixed"; }

std::map<int, std::vector<BoxRay>> rays_by_label(const std::deque<ObservedFrame>& window,
                                                 const std::vector<LocalFrame>& frames,
                                                 const LandmarkRedirects& redirects, const LoopOptions& options) {
  std::map<int, std::vector<BoxRay>> rays;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    for (const ObservedBox& box : window[f].boxes) {
      const Vec2 center = box.box.center();
      const Vec3 ray_camera(center.x(), center.y(), 1.0);
      const Vec3 direction = frames[f].R_camera_local.transpose() * ray_camera.normalized();
      const double depth_m = uses_depth(options) ? box.depth_m : 0.0;
      rays[box.label].push_back({static_cast<int>(f), redirects.resolve(box.landmark_id), box.track_id, box.class_id,
                                 box.box, box.truncated, direction, depth_m,
                                 frames[f].position + depth_m * ray_camera.norm() * direction});
    }
  }
  return rays;
}

/// The value that most of a cluster's boxes have in a field, the lowest on ties.
template <class Value>
Value commonest(const std::vector<BoxRay>& rays, const RayCluster& cluster, Value BoxRay::*field) {
  std::map<Value, int> counts;
  for (const int i : cluster.rays) ++counts[rays[static_cast<std::size_t>(i)].*field];
  return with_most(counts);
}

/// Of two objects of one label in one place, the better seen one stays.
void remove_duplicates(std::vector<LocalObject>* objects) {
  std::stable_sort(objects->begin(), objects->end(),
                   [](const LocalObject& p, const LocalObject& q) { return p.frames_seen > q.frames_seen; });
  std::vector<LocalObject> kept;
  for (LocalObject& object : *objects) {
    const bool duplicate = std::any_of(kept.begin(), kept.end(), [&](const LocalObject& other) {
      const double radius = 0.5 * (object.spheroid.radius() + other.spheroid.radius());
      return object.label == other.label &&
             (object.spheroid.center - other.spheroid.center).norm() < kDuplicateShare * std::max(kMinRadius_m, radius);
    });
    if (!duplicate) kept.push_back(std::move(object));
  }
  *objects = std::move(kept);
}

/// Drops the frames that nothing refers to.
void compact(LocalMap* map) {
  std::set<int> needed(map->check_frames.begin(), map->check_frames.end());
  for (const LocalObject& object : map->objects) {
    for (const SubmapView& view : object.views) needed.insert(view.frame);
  }
  std::map<int, int> renumbered;
  std::vector<LocalFrame> frames;
  frames.reserve(needed.size());
  for (const int i : needed) {
    renumbered[i] = static_cast<int>(frames.size());
    frames.push_back(std::move(map->frames[static_cast<std::size_t>(i)]));
  }
  map->frames = std::move(frames);
  for (int& i : map->check_frames) i = renumbered[i];
  for (LocalObject& object : map->objects) {
    for (SubmapView& view : object.views) view.frame = renumbered[view.frame];
  }
}

/// Detectors draw a box that the border cuts up to there, or nearly: a side that few boxes bound, none does.
/// @return the views without such bounds, spread over time; none if more than one side is open
std::vector<SubmapView> bounded_views(std::vector<SubmapView> views, std::size_t count) {
  constexpr std::size_t kMinShare = 5;  // one in so many
  int open_sides = 0;
  for (int side = 0; side < 4; ++side) {
    const auto bit = static_cast<std::uint8_t>(1 << side);
    const auto bounds = static_cast<std::size_t>(std::count_if(
        views.begin(), views.end(), [bit](const SubmapView& view) { return (view.truncated & bit) == 0; }));
    if (kMinShare * bounds >= views.size()) continue;
    ++open_sides;
    for (SubmapView& view : views) view.truncated = static_cast<std::uint8_t>(view.truncated | bit);
  }
  return open_sides > 1 ? std::vector<SubmapView>() : spread(views, count);
}

/// The whole boxes, or, where depth is known for most, those with depth, cut or not.
std::vector<SubmapView> views_of(const RayCluster& cluster, const std::vector<BoxRay>& rays) {
  std::vector<SubmapView> whole, placed;
  for (const int i : cluster.rays) {
    const BoxRay& ray = rays[static_cast<std::size_t>(i)];
    const SubmapView view{ray.frame, ray.box, ray.depth_m, ray.truncated};
    if (ray.is_whole()) whole.push_back(view);
    if (ray.is_placed()) placed.push_back(view);
  }
  return 2 * placed.size() < whole.size() ? whole : placed;
}

std::optional<LocalObject> fit_object(const LocalMap& map, const std::vector<SubmapView>& views, const Vec3& center,
                                      const LoopOptions& options) {
  LocalObject object;
  object.views = bounded_views(views, static_cast<std::size_t>(options.fit_views));
  if (object.views.empty()) return std::nullopt;
  const std::optional<SpheroidFit> fit = fit_spheroid(map, object.views, center);
  if (!fit) return std::nullopt;
  object.spheroid = fit->spheroid;
  object.covariance = fit->center_covariance;
  if ((object.spheroid.center - center).norm() > kMaxFitShift_m || object.spheroid.radius() > options.max_radius_m) {
    return std::nullopt;
  }
  return object;
}

std::vector<LocalObject> find_objects(const std::deque<ObservedFrame>& window, const LocalMap& map,
                                      const LandmarkRedirects& redirects, const LoopOptions& options) {
  std::vector<LocalObject> objects;
  for (const auto& [label, rays] : rays_by_label(window, map.frames, redirects, options)) {
    for (const RayCluster& cluster : cluster_rays(rays, map.frames, options)) {
      const auto visible = std::count_if(map.frames.begin(), map.frames.end(), [&](const LocalFrame& frame) {
        return in_view(frame, cluster.center, options.max_depth_m);
      });
      const double seen_share =
          static_cast<double>(cluster.rays.size()) / std::max<double>(static_cast<double>(visible), 1.0);
      if (seen_share < options.min_seen_share) continue;
      std::optional<LocalObject> object = fit_object(map, views_of(cluster, rays), cluster.center, options);
      if (!object) continue;
      object->landmark_id = commonest(rays, cluster, &BoxRay::landmark_id);
      object->label = label;
      object->class_id = commonest(rays, cluster, &BoxRay::class_id);
      object->frames_seen = static_cast<int>(cluster.rays.size());
      object->seen_share = std::min(seen_share, 1.0);
      object->parallax_deg = degrees(cluster.parallax_rad);
      objects.push_back(std::move(*object));
    }
  }
  remove_duplicates(&objects);
  return objects;
}

}  // namespace

bool in_view(const LocalFrame& frame, const Vec3& point, double max_depth_m) {
  const Vec3 p = frame.to_camera(point);
  if (p.z() < kMinVisibleDepth_m || p.z() > max_depth_m) return false;
  const double mx = kViewMargin * frame.image.width(), my = kViewMargin * frame.image.height();
  const double u = p.x() / p.z(), v = p.y() / p.z();
  return u > frame.image.x1 + mx && u < frame.image.x2 - mx && v > frame.image.y1 + my && v < frame.image.y2 - my;
}

std::optional<std::size_t> middle_keyframe(const std::deque<ObservedFrame>& window) {
  if (window.empty()) return std::nullopt;
  const std::int64_t middle = window.front().stamp_ns + (window.back().stamp_ns - window.front().stamp_ns) / 2;
  const auto distance = [&](std::size_t i) { return std::abs(window[i].stamp_ns - middle); };
  std::optional<std::size_t> best;
  for (std::size_t i = 0; i < window.size(); ++i) {
    if (window[i].is_keyframe && (!best || distance(i) < distance(*best))) best = i;
  }
  return best;
}

std::optional<LocalMap> build_local_map(const std::deque<ObservedFrame>& window, const LandmarkRedirects& redirects,
                                        const UpEstimator& up, const LoopOptions& options) {
  const std::optional<std::size_t> middle = middle_keyframe(window);
  if (!middle) return std::nullopt;
  const ObservedFrame* anchor = &window[*middle];
  LocalMap map;
  map.keyframe_id = anchor->keyframe_id;
  map.frame_id = anchor->frame_id;
  map.stamp_ns = anchor->stamp_ns;
  map.begin_frame = window.front().frame_id;
  map.end_frame = window.back().frame_id;
  map.end_ns = window.back().stamp_ns;
  map.T_odom_anchor = anchor->T_odom_camera;
  map.span_s = 1e-9 * static_cast<double>(window.back().stamp_ns - window.front().stamp_ns);
  map.up = up.estimate(anchor->T_odom_camera.q);
  const SE3 T_anchor_odom = anchor->T_odom_camera.inverse();
  for (const ObservedFrame& observed : window) map.frames.push_back(make_frame(observed, T_anchor_odom));
  std::vector<int> all(map.frames.size());
  std::iota(all.begin(), all.end(), 0);
  map.check_frames = spread(all, kCheckFrames);
  for (const int i : map.check_frames) {
    map.frames[static_cast<std::size_t>(i)].boxes = window[static_cast<std::size_t>(i)].boxes;
  }
  map.objects = find_objects(window, map, redirects, options);
  compact(&map);
  if (uses_depth(options)) {
    map.surfels = make_surfels(window, T_anchor_odom);
    map.features = make_features(window, *middle);
  }
  return map;
}

}  // namespace semantic_topo_loop::core
