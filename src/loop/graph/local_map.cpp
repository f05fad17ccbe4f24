#include "loop/graph/local_map.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "geometry/statistics.h"
#include "loop/graph/ray_clusters.h"
#include "semantic_topo_loop/loop/loop_options.h"

namespace semantic_topo_loop::core {
namespace {

using Vec5 = Eigen::Matrix<double, 5, 1>;
using Mat5 = Eigen::Matrix<double, 5, 5>;

constexpr int kCheckFrames = 10;
constexpr int kFitIterations = 8;
constexpr double kFitSigmaPx = 4.0;
constexpr double kLogAxisPriorSigma = 0.5;
constexpr double kMaxFitShift = 0.2;     ///< m; a fit that leaves its rays this far is refused
constexpr double kDuplicateShare = 0.6;  ///< of the mean radius, between two objects' centres
constexpr double kMinDuplicateDistance = 0.03;
constexpr double kViewMargin = 0.1;       ///< of the image, in which an object does not count as in view
constexpr double kMinVisibleDepth = 0.3;  ///< m

const ObservedFrame* middle_keyframe(const std::deque<ObservedFrame>& window) {
  const std::int64_t middle = window.front().stamp_ns + (window.back().stamp_ns - window.front().stamp_ns) / 2;
  const ObservedFrame* best = nullptr;
  for (const ObservedFrame& frame : window) {
    if (!frame.is_keyframe) continue;
    if (best == nullptr || std::abs(frame.stamp_ns - middle) < std::abs(best->stamp_ns - middle)) best = &frame;
  }
  return best;
}

LocalFrame make_frame(const ObservedFrame& observed, const SE3& T_anchor_odom) {
  const SE3 T_local_camera = T_anchor_odom * observed.T_odom_camera;
  LocalFrame frame;
  frame.frame_id = observed.frame_id;
  frame.R_camera_local = T_local_camera.rotation().transpose();
  frame.position = T_local_camera.t;
  frame.t_camera_local = -frame.R_camera_local * frame.position;
  frame.focal_px = observed.focal_px;
  frame.image = observed.image;
  frame.boxes = observed.boxes;
  return frame;
}

/// Indices of `count` of n items, spread evenly, ends included.
std::vector<int> spread(int n, int count) {
  std::vector<int> indices;
  if (n <= count) {
    for (int i = 0; i < n; ++i) indices.push_back(i);
  } else {
    for (int k = 0; k < count; ++k) indices.push_back(k * (n - 1) / (count - 1));
  }
  return indices;
}

std::map<int, std::vector<BoxRay>> rays_by_label(const std::vector<LocalFrame>& frames,
                                                 const LandmarkRedirects& redirects) {
  std::map<int, std::vector<BoxRay>> rays;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    for (const ObservedBox& box : frames[f].boxes) {
      const Vec2 center = box.box.center();
      const Vec3 direction = frames[f].R_camera_local.transpose() * Vec3(center.x(), center.y(), 1.0).normalized();
      rays[box.label].push_back({static_cast<int>(f), redirects.resolve(box.landmark_id), box.track_id, box.class_id,
                                 box.box, box.truncated == 0, direction});
    }
  }
  return rays;
}

/// The value that most of a cluster's boxes have in a field, the lowest on ties.
template <class Value>
Value commonest(const std::vector<BoxRay>& rays, const RayCluster& cluster, Value BoxRay::*field) {
  std::map<Value, int> counts;
  for (const int i : cluster.rays) ++counts[rays[static_cast<std::size_t>(i)].*field];
  return std::max_element(counts.begin(), counts.end(),
                          [](const auto& p, const auto& q) { return p.second < q.second; })
      ->first;
}

/// Half width and half height of the boxes at their depths, as logs.
Vec2 log_axes_of_boxes(const LocalMap& map, const std::vector<SubmapView>& views, const Vec3& center) {
  std::vector<double> halves_x, halves_y;
  for (const SubmapView& view : views) {
    const double depth = map.frames[static_cast<std::size_t>(view.frame)].to_camera(center).z();
    halves_x.push_back(0.5 * depth * view.box.width());
    halves_y.push_back(0.5 * depth * view.box.height());
  }
  return {std::log(std::max(median(halves_x), 0.01)), std::log(std::max(median(halves_y), 0.01))};
}

/// Normal equations of the box edges with soft-L1 weights and a weak prior on the axes.
struct SpheroidFit {
  const LocalMap& map;
  const std::vector<SubmapView>& views;
  Vec2 prior_log_axes;

  /// @return the cost, or infinity if a view cannot see the spheroid
  double linearise(const Spheroid& spheroid, Mat5* H, Vec5* g) const {
    H->setZero();
    g->setZero();
    const Vec2 prior = (spheroid.log_axes - prior_log_axes) / kLogAxisPriorSigma;
    H->diagonal().tail<2>().setConstant(1.0 / (kLogAxisPriorSigma * kLogAxisPriorSigma));
    g->tail<2>() = prior / kLogAxisPriorSigma;
    double cost = prior.squaredNorm();
    for (const SubmapView& view : views) {
      const LocalFrame& frame = map.frames[static_cast<std::size_t>(view.frame)];
      const auto projection = project_spheroid(frame.to_camera(spheroid.center),
                                               frame.R_camera_local * map.up.direction, spheroid.log_axes);
      if (!projection) return std::numeric_limits<double>::infinity();
      const Vec4 scale =
          Vec4(frame.focal_px.x(), frame.focal_px.y(), frame.focal_px.x(), frame.focal_px.y()) / kFitSigmaPx;
      Eigen::Matrix<double, 4, 5> J;
      J << projection->d_center * frame.R_camera_local, projection->d_log_axes;
      J = scale.asDiagonal() * J;
      const Vec4 r = scale.cwiseProduct(projection->edges - view.box.edges());
      const Vec4 root = (Vec4::Ones() + r.cwiseAbs2()).cwiseSqrt();
      const Vec4 weight = root.cwiseInverse();
      cost += 2.0 * (root.sum() - 4.0);
      *H += J.transpose() * weight.asDiagonal() * J;
      *g += J.transpose() * weight.cwiseProduct(r);
    }
    return cost;
  }
};

/// Levenberg-Marquardt over centre and log axes.
bool minimise(const SpheroidFit& fit, Spheroid* spheroid, Mat3* covariance) {
  Mat5 H, H_next;
  Vec5 g, g_next;
  double cost = fit.linearise(*spheroid, &H, &g);
  if (!std::isfinite(cost)) return false;
  double damping = 1e-3;
  for (int i = 0; i < kFitIterations; ++i) {
    Mat5 damped = H;
    damped.diagonal() *= 1.0 + damping;
    const Vec5 step = -damped.ldlt().solve(g);
    if (!step.allFinite()) return false;
    Spheroid next = *spheroid;
    next.center += step.head<3>();
    next.log_axes += step.tail<2>();
    const double next_cost = fit.linearise(next, &H_next, &g_next);
    if (next_cost < cost) {
      const bool converged = cost - next_cost < 1e-4 * cost;
      *spheroid = next;
      cost = next_cost;
      H = H_next;
      g = g_next;
      damping *= 0.1;
      if (converged) break;
    } else {
      damping *= 10.0;
    }
  }
  const Mat5 inverse = H.ldlt().solve(Mat5::Identity());
  *covariance = inverse.topLeftCorner<3, 3>();
  return spheroid->center.allFinite() && covariance->allFinite();
}

/// Of two objects of one label in one place, the better seen one stays.
void remove_duplicates(std::vector<LocalObject>* objects) {
  std::stable_sort(objects->begin(), objects->end(),
                   [](const LocalObject& p, const LocalObject& q) { return p.frames_seen > q.frames_seen; });
  std::vector<LocalObject> kept;
  for (LocalObject& object : *objects) {
    const bool duplicate = std::any_of(kept.begin(), kept.end(), [&](const LocalObject& other) {
      const double radius = 0.5 * (object.spheroid.radius() + other.spheroid.radius());
      return object.label == other.label && (object.spheroid.center - other.spheroid.center).norm() <
                                                kDuplicateShare * std::max(kMinDuplicateDistance, radius);
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

}  // namespace

bool in_view(const LocalFrame& frame, const Vec3& point, double max_depth_m) {
  const Vec3 p = frame.to_camera(point);
  if (p.z() < kMinVisibleDepth || p.z() > max_depth_m) return false;
  const double mx = kViewMargin * frame.image.width(), my = kViewMargin * frame.image.height();
  const double u = p.x() / p.z(), v = p.y() / p.z();
  return u > frame.image.x1 + mx && u < frame.image.x2 - mx && v > frame.image.y1 + my && v < frame.image.y2 - my;
}

LocalMapBuilder::LocalMapBuilder(const LoopOptions& options)
    : min_views_(options.min_views),
      fit_views_(options.fit_views),
      min_parallax_rad_(radians(options.min_parallax_deg)),
      min_seen_share_(options.min_seen_share),
      max_depth_m_(options.max_depth_m),
      max_radius_m_(options.max_radius_m) {}

std::optional<LocalMap> LocalMapBuilder::build(const std::deque<ObservedFrame>& window,
                                               const LandmarkRedirects& redirects, const UpEstimator& up) const {
  if (window.empty()) return std::nullopt;
  const ObservedFrame* anchor = middle_keyframe(window);
  if (anchor == nullptr) return std::nullopt;
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
  map.check_frames = spread(static_cast<int>(map.frames.size()), kCheckFrames);
  map.objects = find_objects(map, redirects);
  compact(&map);
  return map;
}

std::vector<LocalObject> LocalMapBuilder::find_objects(const LocalMap& map, const LandmarkRedirects& redirects) const {
  const RayClusterOptions cluster_options{min_views_, min_parallax_rad_, max_depth_m_};
  std::vector<LocalObject> objects;
  for (const auto& [label, rays] : rays_by_label(map.frames, redirects)) {
    for (const RayCluster& cluster : cluster_rays(rays, map.frames, cluster_options)) {
      const auto visible = std::count_if(map.frames.begin(), map.frames.end(), [&](const LocalFrame& frame) {
        return in_view(frame, cluster.center, max_depth_m_);
      });
      const double seen_share =
          static_cast<double>(cluster.rays.size()) / std::max<double>(static_cast<double>(visible), 1.0);
      if (seen_share < min_seen_share_) continue;
      std::vector<SubmapView> views;
      for (const int i : cluster.rays) {
        const BoxRay& ray = rays[static_cast<std::size_t>(i)];
        if (ray.full) views.push_back({ray.frame, ray.box});
      }
      std::optional<LocalObject> object = fit(map, std::move(views), cluster.center);
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

std::optional<LocalObject> LocalMapBuilder::fit(const LocalMap& map, std::vector<SubmapView> views,
                                                const Vec3& center) const {
  LocalObject object;
  for (const int i : spread(static_cast<int>(views.size()), fit_views_)) {
    object.views.push_back(views[static_cast<std::size_t>(i)]);
  }
  object.spheroid.center = center;
  object.spheroid.log_axes = log_axes_of_boxes(map, object.views, center);
  const SpheroidFit problem{map, object.views, object.spheroid.log_axes};
  if (!minimise(problem, &object.spheroid, &object.covariance)) return std::nullopt;
  if ((object.spheroid.center - center).norm() > kMaxFitShift || object.spheroid.radius() > max_radius_m_) {
    return std::nullopt;
  }
  return object;
}

}  // namespace semantic_topo_loop::core
