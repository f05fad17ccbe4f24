#include "semantic_topo_loop/types/se3.h"

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

}  // namespace semantic_topo_loop::core
