#pragma once

#include <vector>

#include "semantic_topo_loop/geometry/camera.h"

namespace semantic_topo_loop::core {

/// The points of one object: those that project into its box, without outliers (PCL statistical removal) and reduced to
/// the cluster nearest to the box's middle (PCL Euclidean clustering), since a box also shows what is behind.
/// @param points_camera points of the frame, camera frame, m   @param box undistorted, px
/// @return empty if too few points are left
std::vector<Vec3> object_points(const std::vector<Vec3>& points_camera, const Camera& camera, const Box& box);

}  // namespace semantic_topo_loop::core
