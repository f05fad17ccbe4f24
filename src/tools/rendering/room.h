#pragma once

#include "semantic_topo_loop/types/stamp.h"
#include "tools/simulation/scene.h"

namespace semantic_topo_loop::core {

/// Floor, four walls and ceiling around a scene: a box seen from inside.
struct Room {
  SE3 T_world_room;          ///< middle of the box; z up, x and y along the first desk's
  Vec3 half = Vec3::Ones();  ///< half the length of its edges, m
};

/// The smallest room with its floor at z = 0 that keeps the walls clear of furniture and of the camera.
/// @param camera_path T_world_camera
Room room_around(const Scene& scene, const StampedPoses& camera_path);

}  // namespace semantic_topo_loop::core
