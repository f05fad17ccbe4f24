#pragma once

#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// Skew-symmetric matrix: `hat(v) * w = v x w`.
Mat3 hat(const Vec3& v);
/// Rotation vector (rad) to unit quaternion, exact at zero.
Quaternion so3_exp(const Vec3& rotation_vector);
/// Unit quaternion to rotation vector (rad) of norm at most pi.
Vec3 so3_log(const Quaternion& rotation);
/// Decoupled exponential: (translation m, rotation vector rad) to SE3(exp(rotation), translation).
SE3 se3_exp(const Vec6& tangent);
/// Inverse of se3_exp.
Vec6 se3_log(const SE3& T);
/// Angle of the rotation between two poses, rad in [0, pi].
double rotation_angle(const Quaternion& a, const Quaternion& b);
/// Interpolates from a (ratio 0) to b (ratio 1): linear in translation, spherical in rotation.
SE3 interpolate(const SE3& a, const SE3& b, double ratio);

}  // namespace semantic_topo_loop::core
