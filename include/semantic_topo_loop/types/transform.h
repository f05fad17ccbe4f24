#pragma once

#include <cmath>

#include "semantic_topo_loop/types/eigen.h"

namespace semantic_topo_loop::core {

/// Whether a quaternion from outside is meant as a rotation: its norm may be off as with two printed digits.
inline bool is_rotation(const Quaternion& q) {
  constexpr double kMaxNormError = 0.01;
  return std::abs(q.norm() - 1.0) <= kMaxNormError;
}

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

using Vec7 = Eigen::Matrix<double, 7, 1>;
using Mat7 = Eigen::Matrix<double, 7, 7>;

/// A similarity `S_a_b`: `p_a = scale * (T.q * p_b) + T.t`, with T.t in a's unit of length and `scale` the units of a
/// in one of b. With a scale of 1 it does what T alone does, to the last bit.
struct Sim3 {
  SE3 T;
  double scale = 1.0;  ///< > 0

  Sim3() = default;
  explicit Sim3(const SE3& rigid, double scale_a_b = 1.0) : T(rigid), scale(scale_a_b) {}

  Sim3 inverse() const;
  Sim3 operator*(const Sim3& other) const;
  Vec3 operator*(const Vec3& point) const { return scale * (T.q * point) + T.t; }
  /// Where a camera is in a that is at T_b_camera in b; a camera has a pose, and no scale.
  SE3 pose(const SE3& T_b_camera) const;
  bool is_finite() const;
};

}  // namespace semantic_topo_loop::core
