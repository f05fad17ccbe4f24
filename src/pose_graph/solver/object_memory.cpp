#include "pose_graph/solver/object_memory.h"

#include <algorithm>
#include <optional>

#include "geometry/depth_points.h"
#include "geometry/statistics.h"

namespace semantic_topo_loop::core {
namespace {

/// @return none where the frame has too few points on the object, or only a part of it is in the image
std::optional<SurfaceDepth> surface_depth(const std::optional<FramePoints>& frame_points,
                                          const Association& association) {
  if (!frame_points || association.truncated != 0) return std::nullopt;
  const std::vector<Vec3> points = object_points(*frame_points, association.box);
  if (points.empty()) return std::nullopt;
  SurfaceDepth depth;
  depth.ray_camera = frame_points->camera().ray(association.box.center()).normalized();
  std::vector<double> distances;
  for (const Vec3& point : points) distances.push_back(depth.ray_camera.dot(point));
  depth.distance_m = median(std::move(distances));
  return depth;
}

}  // namespace

void ObjectMemory::add(int vertex, const Frame& frame, const AssociationFrame& associations) {
  const Camera& camera = frame.camera;
  std::optional<FramePoints> points;
  if (frame.points_camera) points.emplace(*frame.points_camera, camera);
  for (const Association& association : associations.associations) {
    if (association.landmark_id < 0) continue;
    sightings_.push_back({association.landmark_id,
                          {vertex, Vec4(camera.fx, camera.fy, camera.cx, camera.cy), association.box,
                           association.truncated, surface_depth(points, association)}});
  }
}

void ObjectMemory::apply(const MapUpdate& update, const std::map<std::int64_t, int>& vertex_of,
                         const std::vector<SE3>& T_map_vertex) {
  for (const LandmarkMerge& merge : update.unmerged) survivor_of_.erase(merge.merged_id);
  for (const LandmarkMerge& merge : update.merged) {
    survivor_of_[merge.merged_id] = merge.survivor_id;
    landmarks_.erase(merge.merged_id);
  }
  for (const std::int64_t id : update.removed) landmarks_.erase(id);
  for (const Landmark& landmark : update.changed) {
    if (landmark.state != LandmarkState::kConfirmed || !landmark.ellipsoid) {
      landmarks_.erase(landmark.id);
      continue;
    }
    const auto anchor = vertex_of.find(landmark.anchor_keyframe_id);
    if (anchor == vertex_of.end()) continue;
    const SE3& T_map_anchor = T_map_vertex[static_cast<std::size_t>(anchor->second)];
    landmarks_[landmark.id] = {anchor->second,
                               T_map_anchor.inverse() * landmark.ellipsoid->T_world_quadric,
                               landmark.ellipsoid->semi_axes,
                               {}};
  }
}

std::vector<GraphObject> ObjectMemory::objects() const {
  std::map<std::int64_t, GraphObject> objects = landmarks_;
  for (const Sighting& sighting : sightings_) {
    const auto object = objects.find(resolve(sighting.landmark_id));
    if (object != objects.end()) object->second.views.push_back(sighting.view);
  }
  std::vector<GraphObject> result;
  for (auto& [id, object] : objects) result.push_back(std::move(object));
  return result;
}

std::int64_t ObjectMemory::resolve(std::int64_t id) const {
  for (auto it = survivor_of_.find(id); it != survivor_of_.end(); it = survivor_of_.find(id)) id = it->second;
  return id;
}

}  // namespace semantic_topo_loop::core
