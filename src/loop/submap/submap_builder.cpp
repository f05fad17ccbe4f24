#include "loop/submap/submap_builder.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <limits>
#include <map>
#include <numeric>
#include <set>
#include <utility>

#include "geometry/statistics.h"
#include "loop/submap/spheroid.h"
#include "loop/submap/surfels.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kCheckFrames = 10;  ///< in which another submap's objects are looked for: one in 1.5 s of the longest
constexpr double kMaxFitShift_m = 0.2;      ///< a fit that leaves its rays this far is refused
constexpr double kDuplicateShare = 0.6;     ///< of the mean radius, between two objects' centres
constexpr double kMinRadius_m = 0.03;       ///< for that: the centres of small objects are not known better
constexpr double kViewMargin = 0.1;         ///< of the image, in which an object does not count as in view
constexpr double kMinVisibleDepth_m = 0.3;  ///< nearer, an object fills the view

/// A box of a submap as a ray with an extent.
struct BoxRay {
  int frame = -1;  ///< index in LocalMap::frames
  std::int64_t landmark_id = -1;
  std::int64_t track_id = -1;
  int class_id = -1;
  Box box;                         ///< on the plane z = 1
  std::uint8_t truncated = 0;      ///< Truncation bits
  Vec3 direction = Vec3::UnitZ();  ///< unit, local frame
  double depth_m = 0.0;            ///< of the object's centre; 0 where the frame does not tell
  Vec3 point = Vec3::Zero();       ///< where the depth puts that centre, local frame

  bool is_whole() const { return truncated == 0; }
  bool is_placed() const { return depth_m > 0.0; }
  /// Of a box that is cut, depth tells where at least what it shows is.
  bool tells_place() const { return is_whole() || is_placed(); }
};

struct RayCluster {
  Vec3 center = Vec3::Zero();  ///< local frame, m
  std::vector<int> rays;       ///< at most one a frame, ascending
  double parallax_rad = 0.0;   ///< largest angle between two of its whole boxes' rays
  int placed = 0;              ///< rays whose depth is known
};

constexpr double kMinDepth_m = 0.2;     ///< no object is nearer to a camera that sees it whole
constexpr double kVoteOffset = 0.3;     ///< of the box size, between its centre and the projected point
constexpr double kMemberOffset = 0.35;  ///< the same for a box that joins: the point is better known by then
constexpr double kMemberSizeLog = 0.7;  ///< of z * box size against the cluster's median
constexpr int kRefineRounds = 4;        ///< of choosing the boxes and meeting their rays
constexpr int kPairsPerGroup = 32;  ///< of a track's boxes; with half of them on one object, a quarter of the pairs is
constexpr int kGroupRounds = 3;     ///< objects looked for on one track
constexpr int kAnyPairs = 64;       ///< of all boxes of a label, which hold several objects
/// 1/m^2, where the angle of a ray has one: boxes' centres are known to 10 px, depths of centres to 5 cm.
constexpr double kAlongWeight = 0.16;
constexpr double kMinPairAngle = 0.05;  ///< rad, 3 deg: below it the depth of the meeting point is anyone's guess

/// Finds the points at which the boxes of one label meet. Tracks propose points; the boxes decide: a track that
/// holds two objects is split, and boxes of one object on several tracks are gathered.
class Clustering {
 public:
  Clustering(const std::vector<BoxRay>& rays, const std::vector<LocalFrame>& frames, const LoopOptions& options)
      : rays_(rays), frames_(frames), options_(options) {
    targets_.reserve(rays.size());
    for (const BoxRay& ray : rays) {
      const Vec2 size(ray.box.width(), ray.box.height());
      targets_.push_back({ray.box.center(), size, ray.box.size(), ray.frame, ray.truncated, ray.is_placed()});
    }
    cameras_.reserve(frames.size());
    for (const LocalFrame& frame : frames) cameras_.push_back({frame.R_camera_local, frame.t_camera_local});
    std::vector<int> all(rays.size());
    std::iota(all.begin(), all.end(), 0);
    set_open(std::move(all));
  }

  std::vector<RayCluster> run() {
    std::vector<Proposal> proposals;
    std::map<std::int64_t, std::vector<int>> groups;
    for (const int i : unused()) groups[ray(i).track_id].push_back(i);
    for (const auto& [track, members] : groups) propose(members, &proposals);
    gather(std::move(proposals));
    // Tracks end when an object leaves the view, or join two objects; pairs of any boxes find what they miss.
    proposals.clear();
    propose_any(&proposals);
    gather(std::move(proposals));
    return std::move(clusters_);
  }

 private:
  struct Camera {
    Mat3 R;
    Vec3 t;
  };
  struct Proposal {
    Vec3 point;
    std::size_t support;  ///< boxes of its track that agree on it
    int votes = 0;        ///< not more, once counted: see votes()
  };
  /// What is read of a box for every point, apart from the rest, since most of the time is spent on it.
  struct Target {
    Vec2 center, size;
    double mean_size;
    int frame;
    std::uint8_t truncated;
    bool is_placed;
  };

  const BoxRay& ray(int i) const { return rays_[static_cast<std::size_t>(i)]; }
  const LocalFrame& frame_of(int i) const { return frames_[static_cast<std::size_t>(ray(i).frame)]; }
  const Target& target(int i) const { return targets_[static_cast<std::size_t>(i)]; }

  void set_open(std::vector<int> open) {
    open_ = std::move(open);
    open_frames_ = 0;
    for (std::size_t k = 0; k < open_.size(); ++k) {
      if (k == 0 || target(open_[k]).frame != target(open_[k - 1]).frame) ++open_frames_;
    }
  }

  /// The boxes that tell a place and belong to no cluster yet.
  std::vector<int> unused() const {
    std::vector<int> indices;
    std::copy_if(open_.begin(), open_.end(), std::back_inserter(indices),
                 [this](int i) { return ray(i).tells_place(); });
    return indices;
  }

  /// @return the point in a frame's camera; no box fits it if its depth is less than kMinDepth_m
  Vec3 in_camera(const Vec3& point, int frame) const {
    const Camera& camera = cameras_[static_cast<std::size_t>(frame)];
    return camera.R * point + camera.t;
  }
  /// How far a point is from the middle of a box, as a share of the box size; infinite behind the camera.
  /// @param p in the camera
  static double offset(const Vec3& p, const Target& box) {
    if (p.z() < kMinDepth_m) return std::numeric_limits<double>::infinity();
    const Vec2 share = (p.head<2>() / p.z() - box.center).cwiseQuotient(box.size);
    if (!box.is_placed) return std::max(std::abs(share.x()), std::abs(share.y()));
    return std::max(beyond(share.x(), box.truncated), beyond(share.y(), box.truncated >> 1));
  }
  /// True if that is less than a share. Most points are far from most boxes, so that nothing is divided.
  static bool fits(const Vec3& p, const Target& box, double share) {
    if (box.is_placed || p.z() < kMinDepth_m) return offset(p, box) < share;
    const double reach = share * p.z();
    return std::abs(p.x() - p.z() * box.center.x()) < reach * box.size.x() &&
           std::abs(p.y() - p.z() * box.center.y()) < reach * box.size.y();
  }
  bool is_near(const Vec3& point, int i, double share) const {
    return fits(in_camera(point, target(i).frame), target(i), share);
  }
  /// How far outside the shares of a box its object's centre may be: up to a box size on the other side of a cut.
  /// @param cut bit 0: the lower side, bit 2: the upper side
  static double beyond(double share, int cut) {
    const bool is_cut = (cut & (share < 0.0 ? 1 : 4)) != 0;
    return is_cut ? std::max(std::abs(share) - 1.0, 0.0) : std::abs(share);
  }

  /// Where depth puts the first, or the middle of the shortest segment between two rays, if it lies before both
  /// cameras.
  std::optional<Vec3> meet(int i, int j) const {
    if (ray(i).is_placed() && ray(i).depth_m < options_.max_depth_m) return ray(i).point;
    if (!ray(i).is_whole() || !ray(j).is_whole()) return std::nullopt;
    const Vec3 &o1 = frame_of(i).position, &o2 = frame_of(j).position;
    const Vec3 &d1 = ray(i).direction, &d2 = ray(j).direction;
    const double cosine = d1.dot(d2);
    if (cosine > std::cos(kMinPairAngle)) return std::nullopt;
    const Vec3 baseline = o2 - o1;
    const double denominator = 1.0 - cosine * cosine;
    const double s1 = (baseline.dot(d1) - cosine * baseline.dot(d2)) / denominator;
    const double s2 = (cosine * baseline.dot(d1) - baseline.dot(d2)) / denominator;
    if (s1 < kMinDepth_m || s2 < kMinDepth_m || s1 > options_.max_depth_m || s2 > options_.max_depth_m)
      return std::nullopt;
    return 0.5 * (o1 + s1 * d1 + o2 + s2 * d2);
  }

  /// Points from pairs that lie far apart in time, spread over the members.
  std::vector<Vec3> pair_points(const std::vector<int>& members, int count) const {
    std::vector<Vec3> points;
    const int n = static_cast<int>(members.size());
    for (int k = 0; n >= 2 && k < count; ++k) {
      const int first = k * n / count;
      // Separations of a half, a third, a quarter ... of the members, in turn.
      const int second = (first + std::max(1, n / (2 + k % 4))) % n;
      if (second == first) continue;
      const auto point = meet(members[static_cast<std::size_t>(first)], members[static_cast<std::size_t>(second)]);
      if (point) points.push_back(*point);
    }
    return points;
  }

  /// The points that most of a track's boxes agree on.
  void propose(std::vector<int> members, std::vector<Proposal>* proposals) const {
    for (int round = 0; round < kGroupRounds && members.size() >= 3; ++round) {
      std::size_t best_votes = 2;
      std::optional<Vec3> best;
      for (const Vec3& point : pair_points(members, kPairsPerGroup)) {
        const std::size_t votes = votes_among(members, point, best_votes);
        if (votes <= best_votes) continue;
        best_votes = votes;
        best = point;
      }
      if (!best) return;
      proposals->push_back({*best, best_votes});
      members.erase(
          std::remove_if(members.begin(), members.end(), [&](int i) { return is_near(*best, i, kMemberOffset); }),
          members.end());
    }
  }

  void propose_any(std::vector<Proposal>* proposals) const {
    for (const Vec3& point : pair_points(unused(), kAnyPairs)) proposals->push_back({point, 0});
  }

  /// @param least counted to the end only as long as it can be more than this
  std::size_t votes_among(const std::vector<int>& members, const Vec3& point, std::size_t least) const {
    std::size_t votes = 0;
    for (std::size_t k = 0; k < members.size() && votes + members.size() - k > least; ++k) {
      votes += is_near(point, members[k], kVoteOffset) ? 1 : 0;
    }
    return votes;
  }

  /// Frames with an open box that fits the point.
  /// @param least counted to the end only as long as it can be so many   @return then the count, else a bound from
  /// above
  int votes(const Vec3& point, int least) const {
    int most = open_frames_, frame = -1;
    bool has_vote = true;
    Vec3 p = Vec3::Zero();
    for (const int i : open_) {
      const Target& box = target(i);
      if (box.frame != frame) {
        most -= has_vote ? 0 : 1;
        if (most < least) return most;
        frame = box.frame;
        p = in_camera(point, frame);
        has_vote = false;
      }
      has_vote = has_vote || fits(p, box, kVoteOffset);
    }
    return most - (has_vote ? 0 : 1);
  }

  /// Turns points into clusters, the best supported first; each box belongs to one cluster.
  void gather(std::vector<Proposal> proposals) {
    int most = options_.min_views;  // of the votes that are counted to the end, or fewer
    // What a long track agrees on first, so that few of the others are counted to the end.
    std::vector<Proposal*> by_support;
    by_support.reserve(proposals.size());
    for (Proposal& proposal : proposals) by_support.push_back(&proposal);
    std::stable_sort(by_support.begin(), by_support.end(),
                     [](const Proposal* p, const Proposal* q) { return p->support > q->support; });
    for (Proposal* proposal : by_support) {
      proposal->votes = votes(proposal->point, most);
      most = std::max(most, proposal->votes);
    }
    // Votes only fall as boxes are used up, so that an old count bounds the new one from above.
    while (!proposals.empty()) {
      const auto best = std::max_element(proposals.begin(), proposals.end(),
                                         [](const Proposal& p, const Proposal& q) { return p.votes < q.votes; });
      const int best_votes = votes(best->point, most);
      if (best_votes < best->votes) {
        best->votes = best_votes;
        most = std::max(most, best_votes);
        continue;
      }
      if (best_votes < options_.min_views) return;
      const std::optional<RayCluster> cluster = refine(best->point);
      proposals.erase(best);
      most = options_.min_views;
      if (!cluster) continue;
      std::vector<int> open;
      std::set_difference(open_.begin(), open_.end(), cluster->rays.begin(), cluster->rays.end(),
                          std::back_inserter(open));
      set_open(std::move(open));
      const bool is_placed = cluster->placed >= options_.min_views;
      if (is_placed || cluster->parallax_rad >= radians(options_.min_parallax_deg)) clusters_.push_back(*cluster);
    }
  }

  std::optional<RayCluster> refine(const Vec3& start) const {
    RayCluster cluster;
    cluster.center = start;
    for (int round = 0; round < kRefineRounds; ++round) {
      cluster.rays = members(cluster.center);
      const std::optional<Vec3> center = triangulate(cluster);
      if (!center) return std::nullopt;
      cluster.center = *center;
    }
    cluster.parallax_rad = parallax(cluster);
    cluster.placed = static_cast<int>(
        std::count_if(cluster.rays.begin(), cluster.rays.end(), [this](int i) { return ray(i).is_placed(); }));
    return cluster;
  }

  /// The best box of every frame among those that fit the point in place and size.
  std::vector<int> members(const Vec3& point) const {
    struct Near {
      int ray;
      double share, size_m;
    };
    std::vector<Near> near;
    std::vector<double> sizes_m;
    int frame = -1;
    Vec3 p = Vec3::Zero();
    for (const int i : open_) {
      const Target& box = target(i);
      if (box.frame != frame) p = in_camera(point, box.frame);
      frame = box.frame;
      if (!fits(p, box, kMemberOffset)) continue;
      near.push_back({i, offset(p, box), p.z() * box.mean_size});
      sizes_m.push_back(near.back().size_m);
    }
    if (near.empty()) return {};
    const double usual_m = median(std::move(sizes_m));
    std::vector<int> result;
    double least = 0.0;  // offset of the last in the result
    for (const Near& box : near) {
      if (std::abs(std::log(box.size_m / usual_m)) >= kMemberSizeLog) continue;
      const bool is_first = result.empty() || target(result.back()).frame != target(box.ray).frame;
      if (!is_first && box.share >= least) continue;
      if (!is_first) result.pop_back();
      result.push_back(box.ray);
      least = box.share;
    }
    return result;
  }

  /// Least squares of the distances to the rays, over depth, and along them to where depth puts the object.
  std::optional<Vec3> triangulate(const RayCluster& cluster) const {
    Mat3 A = Mat3::Zero();
    Vec3 b = Vec3::Zero();
    int views = 0;
    for (const int i : cluster.rays) {
      if (!ray(i).tells_place()) continue;
      const double depth = std::max(frame_of(i).to_camera(cluster.center).z(), kMinVisibleDepth_m);
      const Mat3 across = (Mat3::Identity() - ray(i).direction * ray(i).direction.transpose()) / (depth * depth);
      A += across;
      b += across * frame_of(i).position;
      ++views;
      if (!ray(i).is_placed()) continue;
      const Mat3 along = kAlongWeight * ray(i).direction * ray(i).direction.transpose();
      A += along;
      b += along * ray(i).point;
    }
    if (views < options_.min_views) return std::nullopt;
    const Vec3 center = A.ldlt().solve(b);
    if (!center.allFinite()) return std::nullopt;
    return center;
  }

  double parallax(const RayCluster& cluster) const {
    std::vector<Vec3> directions;
    for (const int i : cluster.rays) {
      if (ray(i).is_whole()) directions.push_back(ray(i).direction);
    }
    double smallest_cosine = 1.0;
    for (std::size_t p = 0; p < directions.size(); ++p) {
      for (std::size_t q = p + 1; q < directions.size(); ++q) {
        smallest_cosine = std::min(smallest_cosine, directions[p].dot(directions[q]));
      }
    }
    return std::acos(std::clamp(smallest_cosine, -1.0, 1.0));
  }

  const std::vector<BoxRay>& rays_;
  const std::vector<LocalFrame>& frames_;
  const LoopOptions& options_;
  std::vector<Target> targets_;  ///< one a ray
  std::vector<Camera> cameras_;  ///< one a frame
  std::vector<int> open_;        ///< rays that belong to no cluster yet, ascending
  int open_frames_ = 0;          ///< that have such rays
  std::vector<RayCluster> clusters_;
};

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
    for (const RayCluster& cluster : Clustering(rays, map.frames, options).run()) {
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
  if (uses_depth(options)) map.surfels = make_surfels(window, T_anchor_odom);
  return map;
}

}  // namespace semantic_topo_loop::core
