#pragma once

#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// Skew-symmetric matrix: `hat(v) * w = v x w`.
Mat3 hat(const Vec3& v);
/// Rotation vector (rad) to unit quaternion, exact at zero.
Quaternion so3_exp(const Vec3& rotation_vector);
/// Unit quaternion to rotation vector (rad) of norm at most pi.
Vec3 so3_log(const Quaternion& rotation);
/// Right Jacobian of the rotation group: so3_exp(v + d) = so3_exp(v) * so3_exp(right_jacobian(v) d) + O(d^2).
Mat3 right_jacobian(const Vec3& rotation_vector);
/// Its inverse: so3_log(so3_exp(v) * so3_exp(d)) = v + right_jacobian_inverse(v) d + O(d^2).
Mat3 right_jacobian_inverse(const Vec3& rotation_vector);
/// Twice the derivative of a quaternion's coefficients (x, y, z, w) by a small rotation of the outer frame. What is
/// differentiated by the coefficients is differentiated by the rotation vector times 2 P^T, for P has orthonormal
/// columns.
Eigen::Matrix<double, 4, 3> quaternion_by_rotation(const Quaternion& rotation);
/// Decoupled exponential: (translation m, rotation vector rad) to SE3(exp(rotation), translation).
SE3 se3_exp(const Vec6& tangent);
/// Inverse of se3_exp.
Vec6 se3_log(const SE3& T);
/// Angle of the rotation between two poses, rad in [0, pi].
double rotation_angle(const Quaternion& a, const Quaternion& b);
/// Interpolates from a (ratio 0) to b (ratio 1): linear in translation, spherical in rotation.
SE3 interpolate(const SE3& a, const SE3& b, double ratio);

}  // namespace semantic_topo_loop::core
