#include "semantic_topo_loop/geometry/quadric.h"

#include <cmath>

namespace semantic_topo_loop::core {
namespace {

/// Roots of the two vertical or horizontal tangent lines, C_ii - 2 u C_i2 + u^2 C_22 = 0 with C_22 = -depth^2 < 0.
bool tangents(double C_ii, double C_i2, double C_22, double* low, double* high) {
  const double discriminant = C_i2 * C_i2 - C_ii * C_22;
  if (!(discriminant > 0.0)) return false;
  const double root = std::sqrt(discriminant);
  *low = (C_i2 + root) / C_22;
  *high = (C_i2 - root) / C_22;
  return true;
}

/// m^2, of the centre's squared depth less that of the extent along the axis: with less the camera touches the surface,
/// and the conic's outline is lost in rounding.
constexpr double kMinDepthSquared = 1e-9;

}  // namespace

Mat34 projection_matrix(const Camera& camera, const SE3& T_world_camera) {
  const SE3 T_camera_world = T_world_camera.inverse();
  Mat34 Rt;
  Rt << T_camera_world.rotation(), T_camera_world.t;
  return camera.intrinsics() * Rt;
}

std::optional<Conic> project(const Mat4& Q_dual_world, const Mat34& P_image_world) {
  const Mat3 C = P_image_world * Q_dual_world * P_image_world.transpose();
  // The centre's homogeneous depth tells in front from behind, which C itself cannot.
  const double depth = -(P_image_world.row(2) * Q_dual_world.col(3))(0);
  if (!C.allFinite() || !(C(2, 2) < -kMinDepthSquared) || !(depth > 0.0)) return std::nullopt;
  return Conic(C / -C(2, 2));
}

std::optional<Box> bounding_box(const Conic& C) {
  Box box;
  if (!(C(2, 2) < 0.0) || !tangents(C(0, 0), C(0, 2), C(2, 2), &box.x1, &box.x2) ||
      !tangents(C(1, 1), C(1, 2), C(2, 2), &box.y1, &box.y2)) {
    return std::nullopt;
  }
  return box;
}

std::optional<Box> project_box(const Vec3& center_world, const Mat3& shape_world, const Mat34& P) {
  const Vec3 c = P.leftCols<3>() * center_world + P.col(3);
  if (!(c.z() > 0.0)) return std::nullopt;
  const Vec3 a0 = shape_world * P.row(0).head<3>().transpose();
  const Vec3 a1 = shape_world * P.row(1).head<3>().transpose();
  const Vec3 a2 = shape_world * P.row(2).head<3>().transpose();
  const double C22 = P.row(2).head<3>().dot(a2) - c.z() * c.z();
  if (!(C22 < -kMinDepthSquared)) return std::nullopt;
  const double C00 = P.row(0).head<3>().dot(a0) - c.x() * c.x();
  const double C02 = P.row(0).head<3>().dot(a2) - c.x() * c.z();
  const double C11 = P.row(1).head<3>().dot(a1) - c.y() * c.y();
  const double C12 = P.row(1).head<3>().dot(a2) - c.y() * c.z();
  Box box;
  if (!tangents(C00, C02, C22, &box.x1, &box.x2) || !tangents(C11, C12, C22, &box.y1, &box.y2)) return std::nullopt;
  return box;
}

std::optional<Box> project_box(const Ellipsoid& ellipsoid, const Mat34& P_image_world) {
  return project_box(ellipsoid.center(), ellipsoid.shape(), P_image_world);
}

std::optional<Box> project_box(const Ellipsoid& ellipsoid, const Mat34& P, BoxJacobian* jacobian) {
  const Mat3 R = ellipsoid.T_world_quadric.rotation();
  const Vec3 squared_axes = ellipsoid.semi_axes.cwiseAbs2();
  const Mat3 M = R * squared_axes.asDiagonal() * R.transpose();
  const Vec3& c = ellipsoid.center();
  const std::optional<Box> box = project_box(c, M, P);
  if (!box || jacobian == nullptr) return box;
  const Vec4 edges = box->edges();
  const Vec3 n2 = P.row(2).head<3>().transpose();
  for (int k = 0; k < 4; ++k) {
    // The plane through the edge, pi = (n, d) = row_axis - u row_2, touches the ellipsoid: F = n'Mn - (n'c + d)^2 = 0.
    const double u = edges(k);
    const Eigen::RowVector4d plane = P.row(k % 2) - u * P.row(2);
    const Vec3 n = plane.head<3>().transpose();
    const double s = n.dot(c) + plane(3);
    const Vec3 Mn = M * n;
    const double F_u = -2.0 * Mn.dot(n2) + 2.0 * s * (n2.dot(c) + P(2, 3));
    const Vec3 m = R.transpose() * n;
    jacobian->center.row(k) = (2.0 * s / F_u) * n.transpose();
    jacobian->rotation.row(k) = (-2.0 / F_u) * Mn.cross(n).transpose();
    jacobian->log_axes.row(k) = (-2.0 / F_u) * squared_axes.cwiseProduct(m.cwiseAbs2()).transpose();
  }
  return box;
}

}  // namespace semantic_topo_loop::core
