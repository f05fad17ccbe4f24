#include "semantic_topo_loop/map/point_map.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "geometry/statistics.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kThinningsMax = 4;  // a keyframe of which less than a sixteenth is left is given up

std::size_t count(const KeyframePoints& points) { return points.sparse.size() + points.semi_dense.size(); }

/// The first point in each cube, in the order given.
std::vector<Eigen::Vector3f> one_a_voxel(const std::vector<Eigen::Vector3f>& points, double voxel_m) {
  using Cube = std::array<std::int32_t, 3>;
  std::vector<std::pair<Cube, std::size_t>> cubes;
  cubes.reserve(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (!points[i].allFinite()) continue;
    Cube cube;
    for (std::size_t k = 0; k < 3; ++k) {
      const double step = std::floor(static_cast<double>(points[i](static_cast<Eigen::Index>(k))) / voxel_m);
      cube[k] = static_cast<std::int32_t>(std::clamp(step, -1e9, 1e9));
    }
    cubes.emplace_back(cube, i);
  }
  std::sort(cubes.begin(), cubes.end());
  const auto same_cube = [](const auto& a, const auto& b) { return a.first == b.first; };
  cubes.erase(std::unique(cubes.begin(), cubes.end(), same_cube), cubes.end());
  std::sort(cubes.begin(), cubes.end(), [](const auto& a, const auto& b) { return a.second < b.second; });
  std::vector<Eigen::Vector3f> result;
  result.reserve(cubes.size());
  for (const auto& [cube, index] : cubes) result.push_back(points[index]);
  return result;
}

}  // namespace

KeyframePoints reduced(const KeyframePoints& points, const PointMapOptions& options) {
  KeyframePoints result;
  for (const SparsePoint& point : points.sparse) {
    if (point.point_camera.allFinite()) result.sparse.push_back(point);
  }
  result.semi_dense = one_a_voxel(points.semi_dense, options.voxel_m);
  return result;
}

void PointMap::add(const Frame& frame) {
  if (begin_at_) T_map_odom_.t = *std::exchange(begin_at_, std::nullopt) - frame.T_odom_camera.t;
  if (!frame.is_keyframe || !frame.keyframe_points || keyframes_.count(frame.keyframe_id) != 0) return;
  Keyframe keyframe;
  keyframe.T_odom_camera = frame.T_odom_camera;
  keyframe.S_map_camera = Sim3(T_map_odom_ * frame.T_odom_camera, scale_);
  keyframe.points = reduced(*frame.keyframe_points, options_);
  insert(frame.keyframe_id, std::move(keyframe));
}

void PointMap::restore(const PointsOfKeyframe& keyframe, const Sim3& S_map_camera) {
  Keyframe restored;
  restored.S_map_camera = S_map_camera;
  restored.points = *keyframe.points;
  insert(keyframe.keyframe_id, std::move(restored));
}

void PointMap::insert(std::int64_t keyframe_id, Keyframe keyframe) {
  keyframe.session = session_;
  size_ += count(keyframe.points);
  keyframes_.emplace(keyframe_id, std::move(keyframe));
  bound();
}

void PointMap::apply(const MapCorrection& correction) {
  T_map_odom_ = correction.T_map_odom;
  begin_at_.reset();
  scale_ = correction.scale;
  if (!correction.changed) return;
  for (const KeyframePose& pose : correction.keyframes) {
    const auto found = keyframes_.find(pose.keyframe_id);
    if (found != keyframes_.end()) found->second.S_map_camera = Sim3(pose.T_map_camera, pose.scale);
  }
  // What is newer than the solution is composed on it.
  for (auto it = keyframes_.upper_bound(correction.valid_to_keyframe_id); it != keyframes_.end(); ++it) {
    it->second.S_map_camera = Sim3(T_map_odom_ * it->second.T_odom_camera, scale_);
  }
}

/// Thins the oldest of the keyframes that have been thinned least, until there is room.
void PointMap::bound() {
  const auto most = static_cast<std::size_t>(options_.points_max);
  while (size_ > most && !keyframes_.empty()) {
    const auto oldest = std::min_element(keyframes_.begin(), keyframes_.end(), [](const auto& a, const auto& b) {
      return a.second.thinnings < b.second.thinnings;
    });
    Keyframe& keyframe = oldest->second;
    const std::size_t before = count(keyframe.points);
    if (keyframe.thinnings == kThinningsMax || before <= 1) {
      keyframe.points = {};
    } else {
      halve(&keyframe.points.sparse);
      halve(&keyframe.points.semi_dense);
      ++keyframe.thinnings;
    }
    const std::size_t after = count(keyframe.points);
    size_ -= before - after;
    if (after == 0) keyframes_.erase(oldest);
  }
}

MapPoints PointMap::points() const {
  MapPoints result;
  std::map<std::pair<int, std::int64_t>, Eigen::Vector3f> sparse;  // the newest keyframe that sees a point knows best
  for (const auto& [id, keyframe] : keyframes_) {
    const Sim3& S_map_camera = keyframe.S_map_camera;
    const Eigen::Matrix3f R = (S_map_camera.scale * S_map_camera.T.rotation()).cast<float>();
    const Eigen::Vector3f t = S_map_camera.T.t.cast<float>();
    for (const SparsePoint& point : keyframe.points.sparse)
      sparse[{keyframe.session, point.id}] = R * point.point_camera + t;
    for (const Eigen::Vector3f& point : keyframe.points.semi_dense) result.semi_dense.push_back(R * point + t);
  }
  result.sparse.reserve(sparse.size());
  for (const auto& [id, point] : sparse) result.sparse.push_back(point);
  return result;
}

}  // namespace semantic_topo_loop::core
