#pragma once

#include <optional>

#include "semantic_topo_loop/types/camera.h"
#include "semantic_topo_loop/types/landmark.h"

namespace semantic_topo_loop::core {

/// P = K [R|t] of the undistorted image.
Mat34 projection_matrix(const Camera& camera, const SE3& T_world_camera);

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

/// Derivatives of the four box edges (x1, y1, x2, y2) of a projected ellipsoid.
struct BoxJacobian {
  Eigen::Matrix<double, 4, 3> center;    ///< by the centre, px/m
  Eigen::Matrix<double, 4, 3> rotation;  ///< by a left rotation vector of the ellipsoid in the world, px/rad
  Eigen::Matrix<double, 4, 3> log_axes;  ///< by the logarithms of the semi-axes, px
};

/// project_box with its derivatives, by implicit differentiation of the tangent plane condition pi^T Q* pi = 0.
std::optional<Box> project_box(const Ellipsoid& ellipsoid, const Mat34& P_image_world, BoxJacobian* jacobian);

}  // namespace semantic_topo_loop::core
