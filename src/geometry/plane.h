#pragma once

#include <optional>
#include <vector>

#include "semantic_topo_loop/types/eigen.h"

namespace semantic_topo_loop::core {

/// The points x with normal.dot(x) + offset = 0.
struct Plane {
  Vec3 normal = Vec3::UnitZ();  ///< unit
  double offset = 0.0;          ///< m

  double distance(const Vec3& point) const { return normal.dot(point) + offset; }
};

/// Distance from a plane up to which a point seen by a depth camera counts as lying in it, m.
double plane_tolerance_m(double depth_m);

/// The plane that holds most of the points (RANSAC with a fixed seed, then least squares over its inliers).
/// @param points_camera finite, in the frame of the camera that saw them   @param hypotheses planes through three
/// points that are tried   @param min_share of the points that must lie in it
/// @return its normal towards the camera; nullopt if no plane holds so many
std::optional<Plane> dominant_plane(const std::vector<Vec3>& points_camera, int hypotheses, double min_share);

}  // namespace semantic_topo_loop::core
