#include "semantic_topo_loop/geometry/lie.h"

#include <cmath>

namespace semantic_topo_loop::core {

Mat3 hat(const Vec3& v) {
  Mat3 m;
  m << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return m;
}

Quaternion so3_exp(const Vec3& rotation_vector) {
  const double angle = rotation_vector.norm();
  // sin(x/2)/x by its series near zero, where the quotient is 0/0.
  const double factor = angle < 1e-6 ? 0.5 - angle * angle / 48.0 : std::sin(0.5 * angle) / angle;
  const Vec3 v = factor * rotation_vector;
  return Quaternion(std::cos(0.5 * angle), v.x(), v.y(), v.z()).normalized();
}

Vec3 so3_log(const Quaternion& rotation) {
  const double sign = rotation.w() < 0.0 ? -1.0 : 1.0;
  const Vec3 v = sign * rotation.vec();
  const double sine = v.norm();
  const double cosine = sign * rotation.w();
  const double factor = sine < 1e-9 ? 2.0 / cosine : 2.0 * std::atan2(sine, cosine) / sine;
  return factor * v;
}

Mat3 right_jacobian(const Vec3& rotation_vector) {
  const double angle = rotation_vector.norm();
  const Mat3 W = hat(rotation_vector);
  // The series near zero, where the quotients are 0/0.
  if (angle < 1e-5) return Mat3::Identity() - 0.5 * W + W * W / 6.0;
  const double angle2 = angle * angle;
  return Mat3::Identity() - (1.0 - std::cos(angle)) / angle2 * W + (angle - std::sin(angle)) / (angle2 * angle) * W * W;
}

Mat3 right_jacobian_inverse(const Vec3& rotation_vector) {
  const double angle = rotation_vector.norm();
  const Mat3 cross = hat(rotation_vector);
  // 1/angle^2 - cot(angle/2)/(2 angle), by its series near zero; regular up to the cut at pi.
  const double factor =
      angle < 1e-3 ? 1.0 / 12.0 + angle * angle / 720.0 : 1.0 / (angle * angle) - 0.5 / (angle * std::tan(0.5 * angle));
  return Mat3::Identity() + 0.5 * cross + factor * cross * cross;
}

Eigen::Matrix<double, 4, 3> quaternion_by_rotation(const Quaternion& q) {
  Eigen::Matrix<double, 4, 3> P;
  P << q.w(), q.z(), -q.y(), -q.z(), q.w(), q.x(), q.y(), -q.x(), q.w(), -q.x(), -q.y(), -q.z();
  return P;
}

SE3 se3_exp(const Vec6& tangent) { return {so3_exp(tangent.tail<3>()), tangent.head<3>()}; }

Vec6 se3_log(const SE3& T) {
  Vec6 tangent;
  tangent << T.t, so3_log(T.q);
  return tangent;
}

double rotation_angle(const Quaternion& a, const Quaternion& b) {
  const Quaternion difference = a.conjugate() * b;
  return 2.0 * std::atan2(difference.vec().norm(), std::abs(difference.w()));
}

SE3 interpolate(const SE3& a, const SE3& b, double ratio) {
  return {a.q.slerp(ratio, b.q).normalized(), a.t + ratio * (b.t - a.t)};
}

}  // namespace semantic_topo_loop::core
