#pragma once

#include <cmath>

#include "semantic_topo_loop/types/se3.h"

namespace semantic_topo_loop::core {

/// An ellipsoid: pose of its axes in the world and its semi-axes.
struct Ellipsoid {
  SE3 T_world_quadric;
  Vec3 semi_axes = Vec3::Ones();  ///< m, > 0

  const Vec3& center() const { return T_world_quadric.t; }
  /// Radius of the sphere of the same volume, m.
  double radius() const { return std::cbrt(semi_axes.prod()); }
  /// R diag(a^2) R^T, m^2.
  Mat3 shape() const;
  /// Q* = Z diag(a^2, b^2, c^2, -1) Z^T with Z = T_world_quadric (SemanticTopoLoop, quadric representation).
  Mat4 dual() const;
};

}  // namespace semantic_topo_loop::core
