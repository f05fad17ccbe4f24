#pragma once

#include <optional>

#include "semantic_topo_loop/geometry/box.h"
#include "semantic_topo_loop/geometry/se3.h"

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

using Conic = Mat3;  ///< dual conic C*, scaled so that C*(2,2) = -1

/// Projects a dual quadric: C* = P Q* P^T (SemanticTopoLoop, 3D-level verification).
/// @param Q_dual_world 4x4 symmetric, metres   @param P_image_world 3x4 = K [R|t]
/// @return nullopt if the quadric touches or lies behind the camera's principal plane, so that no ellipse is seen
std::optional<Conic> project(const Mat4& Q_dual_world, const Mat34& P_image_world);
/// The rectangle around the ellipse of a dual conic, px, not clipped.
std::optional<Box> bounding_box(const Conic& C_dual_image);
/// The rectangle around the projected ellipsoid, px, not clipped; nullopt as for project().
std::optional<Box> project_box(const Ellipsoid& ellipsoid, const Mat34& P_image_world);
/// The same from centre and shape matrix, for callers that keep them.
std::optional<Box> project_box(const Vec3& center_world, const Mat3& shape_world, const Mat34& P_image_world);

}  // namespace semantic_topo_loop::core
