#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

Mat4 SE3::matrix() const {
  Mat4 T = Mat4::Identity();
  T.topLeftCorner<3, 3>() = rotation();
  T.topRightCorner<3, 1>() = t;
  return T;
}

SE3 SE3::inverse() const {
  const Quaternion q_inverse = q.conjugate().normalized();
  return {q_inverse, -(q_inverse * t)};
}

SE3 SE3::operator*(const SE3& other) const { return {(q * other.q).normalized(), q * other.t + t}; }

Sim3 Sim3::inverse() const {
  const Quaternion q_inverse = T.q.conjugate().normalized();
  const double scale_inverse = 1.0 / scale;
  return Sim3(SE3(q_inverse, -(scale_inverse * (q_inverse * T.t))), scale_inverse);
}

Sim3 Sim3::operator*(const Sim3& other) const { return Sim3(pose(other.T), scale * other.scale); }

SE3 Sim3::pose(const SE3& T_b_camera) const {
  return {(T.q * T_b_camera.q).normalized(), scale * (T.q * T_b_camera.t) + T.t};
}

bool Sim3::is_finite() const { return T.is_finite() && std::isfinite(scale) && scale > 0.0; }

}  // namespace semantic_topo_loop::core
