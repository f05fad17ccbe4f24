#pragma once

#include "semantic_topo_loop/types/eigen.h"

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

}  // namespace semantic_topo_loop::core
