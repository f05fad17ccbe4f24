#include "tools/rendering/room.h"

#include <limits>

namespace semantic_topo_loop::core {
namespace {

constexpr double kFurnitureGapM = 0.15;
constexpr double kCameraGapM = 0.7;
constexpr double kMinHeightM = 2.6;

/// Grows the box [low, high] so that it holds a disc.
void include(const Vec3& center, double radius, Vec3* low, Vec3* high) {
  *low = low->cwiseMin((center.array() - radius).matrix());
  *high = high->cwiseMax((center.array() + radius).matrix());
}

}  // namespace

Room room_around(const Scene& scene, const StampedPoses& camera_path) {
  const SE3& T_world_desk = scene.desks.front().T_world_desk;
  const SE3 T_axes_world = SE3(T_world_desk.q, Vec3::Zero()).inverse();
  Vec3 low = Vec3::Constant(std::numeric_limits<double>::max()), high = -low;
  for (const Desk& desk : scene.desks) {
    include(T_axes_world * desk.T_world_desk.t, std::max(desk.half_depth_m, desk.half_width_m) + kFurnitureGapM, &low,
            &high);
  }
  for (const SceneObject& object : scene.objects) {
    // Who walks through may come out of a wall.
    if (!object.stays()) continue;
    include(T_axes_world * object.ellipsoid.center(), object.ellipsoid.semi_axes.head<2>().maxCoeff() + kFurnitureGapM,
            &low, &high);
  }
  for (const StampedPose& pose : camera_path) include(T_axes_world * pose.T_world_camera.t, kCameraGapM, &low, &high);
  low.z() = 0.0;
  high.z() = std::max(high.z(), kMinHeightM);
  Room room;
  room.T_world_room = T_axes_world.inverse() * SE3(Quaternion::Identity(), 0.5 * (low + high));
  room.half = 0.5 * (high - low);
  return room;
}

}  // namespace semantic_topo_loop::core
