#include "loop/submap/ray_clusters.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <map>
#include <numeric>
#include <optional>
#include <utility>

#include "geometry/statistics.h"

namespace semantic_topo_loop::core {
namespace {

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

}  // namespace

std::vector<RayCluster> cluster_rays(const std::vector<BoxRay>& rays, const std::vector<LocalFrame>& frames,
                                     const LoopOptions& options) {
  return Clustering(rays, frames, options).run();
}

}  // namespace semantic_topo_loop::core
