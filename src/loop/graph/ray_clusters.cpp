#include "loop/graph/ray_clusters.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <utility>

#include "geometry/statistics.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kMinDepth = 0.2;    ///< m
constexpr double kVoteOffset = 0.3;  ///< of the box size, between its centre and the projected point
constexpr double kMemberOffset = 0.35;
constexpr double kMemberSizeLog = 0.7;  ///< of z * box size against the cluster's median
constexpr int kRefineRounds = 4;
constexpr int kPairsPerGroup = 32;
constexpr int kGroupRounds = 3;  ///< objects looked for on one track
constexpr int kAnyPairs = 64;
constexpr double kMinPairAngle = 0.05;  ///< rad

class Clustering {
 public:
  Clustering(const std::vector<BoxRay>& rays, const std::vector<LocalFrame>& frames, const RayClusterOptions& options)
      : rays_(rays), frames_(frames), options_(options), used_(rays.size(), false) {}

  std::vector<RayCluster> run() {
    std::vector<Vec3> points;
    std::map<std::int64_t, std::vector<int>> groups;
    for (const int i : unused()) groups[ray(i).track_id].push_back(i);
    for (const auto& [track, members] : groups) propose(members, &points);
    // Tracks end when an object leaves the view, or join two objects; pairs of any boxes find what they miss.
    for (const Vec3& point : pair_points(unused(), kAnyPairs)) points.push_back(point);
    gather(std::move(points));
    gather(pair_points(unused(), kAnyPairs));
    return std::move(clusters_);
  }

 private:
  const BoxRay& ray(int i) const { return rays_[static_cast<std::size_t>(i)]; }
  const LocalFrame& frame_of(int i) const { return frames_[static_cast<std::size_t>(ray(i).frame)]; }
  bool is_used(int i) const { return used_[static_cast<std::size_t>(i)]; }

  /// The boxes without cut sides that belong to no cluster yet.
  std::vector<int> unused() const {
    std::vector<int> indices;
    for (int i = 0; i < static_cast<int>(rays_.size()); ++i) {
      if (ray(i).full && !is_used(i)) indices.push_back(i);
    }
    return indices;
  }

  struct Offset {
    double share;  ///< of the box size; infinite behind the camera
    double depth;
  };
  Offset offset(const Vec3& point, int i) const {
    const Vec3 p = frame_of(i).to_camera(point);
    if (p.z() < kMinDepth) return {std::numeric_limits<double>::infinity(), p.z()};
    const Box& box = ray(i).box;
    const double du = std::abs(p.x() / p.z() - 0.5 * (box.x1 + box.x2)) / box.width();
    const double dv = std::abs(p.y() / p.z() - 0.5 * (box.y1 + box.y2)) / box.height();
    return {std::max(du, dv), p.z()};
  }

  /// Middle of the shortest segment between two rays, if it lies before both cameras.
  std::optional<Vec3> meet(int i, int j) const {
    const Vec3 &o1 = frame_of(i).position, &o2 = frame_of(j).position;
    const Vec3 &d1 = ray(i).direction, &d2 = ray(j).direction;
    const double cosine = d1.dot(d2);
    if (cosine > std::cos(kMinPairAngle)) return std::nullopt;
    const Vec3 baseline = o2 - o1;
    const double denominator = 1.0 - cosine * cosine;
    const double s1 = (baseline.dot(d1) - cosine * baseline.dot(d2)) / denominator;
    const double s2 = (cosine * baseline.dot(d1) - baseline.dot(d2)) / denominator;
    if (s1 < kMinDepth || s2 < kMinDepth || s1 > options_.max_depth_m || s2 > options_.max_depth_m) return std::nullopt;
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
  void propose(std::vector<int> members, std::vector<Vec3>* points) const {
    for (int round = 0; round < kGroupRounds && members.size() >= 3; ++round) {
      std::size_t best_votes = 0;
      Vec3 best = Vec3::Zero();
      for (const Vec3& point : pair_points(members, kPairsPerGroup)) {
        const auto votes = static_cast<std::size_t>(
            std::count_if(members.begin(), members.end(), [&](int i) { return offset(point, i).share < kVoteOffset; }));
        if (votes > best_votes) {
          best_votes = votes;
          best = point;
        }
      }
      if (best_votes < 3) return;
      points->push_back(best);
      members.erase(
          std::remove_if(members.begin(), members.end(), [&](int i) { return offset(best, i).share < kMemberOffset; }),
          members.end());
    }
  }

  int votes(const Vec3& point) const {
    int votes = 0, last_frame = -1;
    for (int i = 0; i < static_cast<int>(rays_.size()); ++i) {
      if (is_used(i) || ray(i).frame == last_frame || offset(point, i).share >= kVoteOffset) continue;
      last_frame = ray(i).frame;
      ++votes;
    }
    return votes;
  }

  /// Turns points into clusters, the best supported first; each box belongs to one cluster.
  void gather(std::vector<Vec3> points) {
    // Votes only fall as boxes are used up, so that an old count bounds the new one from above.
    std::vector<int> bounds(points.size(), std::numeric_limits<int>::max());
    while (!points.empty()) {
      const auto best = static_cast<std::size_t>(std::max_element(bounds.begin(), bounds.end()) - bounds.begin());
      const int best_votes = votes(points[best]);
      if (best_votes < bounds[best]) {
        bounds[best] = best_votes;
        continue;
      }
      if (best_votes < options_.min_views) return;
      const std::optional<RayCluster> cluster = refine(points[best]);
      points.erase(points.begin() + static_cast<std::ptrdiff_t>(best));
      bounds.erase(bounds.begin() + static_cast<std::ptrdiff_t>(best));
      if (!cluster) continue;
      for (const int i : cluster->rays) used_[static_cast<std::size_t>(i)] = true;
      if (cluster->parallax_rad >= options_.min_parallax_rad) clusters_.push_back(*cluster);
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
    return cluster;
  }

  /// The best box of every frame among those that fit the point in place and size.
  std::vector<int> members(const Vec3& point) const {
    std::vector<double> sizes;
    std::vector<std::pair<int, Offset>> near;
    for (int i = 0; i < static_cast<int>(rays_.size()); ++i) {
      if (is_used(i)) continue;
      const Offset o = offset(point, i);
      if (o.share >= kMemberOffset) continue;
      near.emplace_back(i, o);
      sizes.push_back(o.depth * ray(i).box.size());
    }
    if (near.empty()) return {};
    const double usual = median(std::move(sizes));
    std::map<int, std::pair<double, int>> best_of_frame;
    for (const auto& [i, o] : near) {
      if (std::abs(std::log(o.depth * ray(i).box.size() / usual)) >= kMemberSizeLog) continue;
      const auto [it, inserted] = best_of_frame.emplace(ray(i).frame, std::pair(o.share, i));
      if (!inserted) it->second = std::min(it->second, std::pair(o.share, i));
    }
    std::vector<int> result;
    for (const auto& [frame, best] : best_of_frame) result.push_back(best.second);
    return result;
  }

  /// Least squares of the distances to the full rays, over depth.
  std::optional<Vec3> triangulate(const RayCluster& cluster) const {
    Mat3 A = Mat3::Zero();
    Vec3 b = Vec3::Zero();
    int views = 0;
    for (const int i : cluster.rays) {
      if (!ray(i).full) continue;
      const double depth = std::max(frame_of(i).to_camera(cluster.center).z(), 0.3);
      const Mat3 across = (Mat3::Identity() - ray(i).direction * ray(i).direction.transpose()) / (depth * depth);
      A += across;
      b += across * frame_of(i).position;
      ++views;
    }
    if (views < options_.min_views) return std::nullopt;
    const Vec3 center = A.ldlt().solve(b);
    if (!center.allFinite()) return std::nullopt;
    return center;
  }

  double parallax(const RayCluster& cluster) const {
    double smallest_cosine = 1.0;
    for (std::size_t p = 0; p < cluster.rays.size(); ++p) {
      if (!ray(cluster.rays[p]).full) continue;
      for (std::size_t q = p + 1; q < cluster.rays.size(); ++q) {
        if (!ray(cluster.rays[q]).full) continue;
        smallest_cosine = std::min(smallest_cosine, ray(cluster.rays[p]).direction.dot(ray(cluster.rays[q]).direction));
      }
    }
    return std::acos(std::clamp(smallest_cosine, -1.0, 1.0));
  }

  const std::vector<BoxRay>& rays_;
  const std::vector<LocalFrame>& frames_;
  const RayClusterOptions& options_;
  std::vector<bool> used_;
  std::vector<RayCluster> clusters_;
};

}  // namespace

std::vector<RayCluster> cluster_rays(const std::vector<BoxRay>& rays, const std::vector<LocalFrame>& frames,
                                     const RayClusterOptions& options) {
  return Clustering(rays, frames, options).run();
}

}  // namespace semantic_topo_loop::core
