#pragma once

#include "semantic_topo_loop/geometry/types.h"

namespace semantic_topo_loop::core {

/// A rigid transform. `T_a_b` maps points of b to a: `p_a = T_a_b * p_b`.
///
/// The members are kept exactly as given, so that a pose travels through a message and back without a changed bit;
/// products and inverses are normalised.
struct SE3 {
  Quaternion q = Quaternion::Identity();  ///< unit rotation
  Vec3 t = Vec3::Zero();                  ///< translation, m

  SE3() = default;
  SE3(const Quaternion& rotation, const Vec3& translation) : q(rotation), t(translation) {}
  SE3(const Mat3& rotation, const Vec3& translation) : q(rotation), t(translation) {}

  Mat3 rotation() const { return q.toRotationMatrix(); }
  Mat4 matrix() const;
  SE3 inverse() const;
  SE3 operator*(const SE3& other) const;
  Vec3 operator*(const Vec3& point) const { return q * point + t; }
  bool is_finite() const { return q.coeffs().allFinite() && t.allFinite(); }
};

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
