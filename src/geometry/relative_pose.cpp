#include "geometry/relative_pose.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <cmath>

namespace semantic_topo_loop::core {

Vec6 relative_pose_residual(const SE3& T_world_from, const SE3& T_world_to, const SE3& T_from_to_measured) {
  return se3_log(T_from_to_measured.inverse() * (T_world_from.inverse() * T_world_to));
}

namespace {

/// Fills in the derivatives. @param rotation_by_local of the rotation residual by a rotation of `to` in its own frame
void differentiate(const SE3& T_world_from, const SE3& T_world_to, const SE3& T_from_to_measured,
                   const Mat3& rotation_by_local, RelativePoseTerms* terms) {
  const Mat3 R_measured_world = (T_world_from.q * T_from_to_measured.q).conjugate().normalized().toRotationMatrix();
  const Mat3 by_rotation = rotation_by_local * T_world_to.q.conjugate().normalized().toRotationMatrix();
  terms->J_from.setZero();
  terms->J_to.setZero();
  terms->J_to.topLeftCorner<3, 3>() = R_measured_world;
  terms->J_to.bottomRightCorner<3, 3>() = by_rotation;
  terms->J_from.topLeftCorner<3, 3>() = -R_measured_world;
  terms->J_from.topRightCorner<3, 3>() = R_measured_world * hat(T_world_to.t - T_world_from.t);
  terms->J_from.bottomRightCorner<3, 3>() = -by_rotation;
}

}  // namespace

RelativePoseTerms relative_pose_terms(const SE3& T_world_from, const SE3& T_world_to, const SE3& T_from_to_measured) {
  RelativePoseTerms terms;
  terms.residual = relative_pose_residual(T_world_from, T_world_to, T_from_to_measured);
  differentiate(T_world_from, T_world_to, T_from_to_measured, right_jacobian_inverse(terms.residual.tail<3>()), &terms);
  return terms;
}

RelativePoseTerms quaternion_pose_terms(const SE3& T_world_from, const SE3& T_world_to, const SE3& T_from_to_measured) {
  SE3 T = T_from_to_measured.inverse() * (T_world_from.inverse() * T_world_to);
  if (T.q.w() < 0.0) T.q.coeffs() *= -1.0;
  RelativePoseTerms terms;
  terms.residual << T.t, T.q.vec();
  differentiate(T_world_from, T_world_to, T_from_to_measured, 0.5 * (T.q.w() * Mat3::Identity() + hat(T.q.vec())),
                &terms);
  return terms;
}

RelativeSimilarityTerms relative_similarity_terms(const Sim3& S_world_from, const Sim3& S_world_to,
                                                  const Sim3& S_from_to_measured) {
  // The pose of `to` that has, with a scale of 1, the relative pose that it has in the unit of `from`.
  const Vec3& t_from = S_world_from.T.t;
  const SE3 T_world_to{S_world_to.T.q, t_from + (S_world_to.T.t - t_from) / S_world_from.scale};
  const RelativePoseTerms rigid = relative_pose_terms(S_world_from.T, T_world_to, S_from_to_measured.T);
  const Mat3 by_step = rigid.J_to.topLeftCorner<3, 3>();
  RelativeSimilarityTerms terms;
  terms.residual << rigid.residual, std::log(S_world_to.scale / (S_world_from.scale * S_from_to_measured.scale));
  terms.J_from.setZero();
  terms.J_to.setZero();
  terms.J_from.topLeftCorner<6, 6>() = rigid.J_from;
  terms.J_to.topLeftCorner<6, 6>() = rigid.J_to;
  terms.J_from.topLeftCorner<3, 3>() = -by_step / S_world_from.scale;
  terms.J_to.topLeftCorner<3, 3>() = by_step / S_world_from.scale;
  terms.J_from.topRightCorner<3, 1>() = -by_step * (T_world_to.t - t_from);
  terms.J_from(6, 6) = -1.0;
  terms.J_to(6, 6) = 1.0;
  return terms;
}

SE3 motion_on_the_way(const SE3& T_from_camera_measured, const SE3& T_from_to_measured, const SE3& T_from_to,
                      double share) {
  return T_from_camera_measured * se3_exp(share * se3_log(T_from_to_measured.inverse() * T_from_to));
}

Mat6 transport(const SE3& T) {
  const Mat3 R_transposed = T.rotation().transpose();
  Mat6 adjoint = Mat6::Zero();
  adjoint.topLeftCorner<3, 3>() = R_transposed;
  adjoint.topRightCorner<3, 3>() = -R_transposed * hat(T.t);
  adjoint.bottomRightCorner<3, 3>() = R_transposed;
  return adjoint;
}

Mat6 inverse_covariance(const SE3& T, const Mat6& covariance) {
  // (T exp(d))^-1 = exp(-d) T^-1, and a sign does not change a covariance.
  const Mat6 carry = transport(T.inverse());
  return carry * covariance * carry.transpose();
}

bool is_covariance(const Mat6& covariance) {
  if (!covariance.allFinite()) return false;
  const double scale = covariance.cwiseAbs().maxCoeff();
  if ((covariance - covariance.transpose()).cwiseAbs().maxCoeff() > 1e-6 * scale) return false;
  const Eigen::SelfAdjointEigenSolver<Mat6> solver(covariance, Eigen::EigenvaluesOnly);
  constexpr double kMinVariance = 1e-14;  // 0.1 um, 0.1 urad: below that nothing was measured
  return solver.info() == Eigen::Success && solver.eigenvalues()(0) > std::max(kMinVariance, 1e-12 * scale);
}

Mat6 square_root_information(const Mat6& covariance) {
  const Mat6 information = covariance.inverse();
  return (0.5 * (information + information.transpose())).llt().matrixU();
}

}  // namespace semantic_topo_loop::core
