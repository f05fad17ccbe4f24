#pragma once

#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// Residual of a relative pose or similarity and its derivatives; the poses are turned in the outer frame:
/// R <- exp(rotation) R.
template <int n>
struct RelativeTerms {
  Eigen::Matrix<double, n, 1> residual;  ///< (translation m, rotation rad, log scale)
  Eigen::Matrix<double, n, n> J_from;    ///< by (translation of from, rotation of from, its log scale)
  Eigen::Matrix<double, n, n> J_to;
};
using RelativePoseTerms = RelativeTerms<6>;
using RelativeSimilarityTerms = RelativeTerms<7>;

/// e = log(T_from_to_measured^-1 * T_world_from^-1 * T_world_to) = (R_z^T (t - t_z), log(R_z^T R)).
Vec6 relative_pose_residual(const SE3& T_world_from, const SE3& T_world_to, const SE3& T_from_to_measured);
/// The same with its analytic derivatives.
RelativePoseTerms relative_pose_terms(const SE3& T_world_from, const SE3& T_world_to, const SE3& T_from_to_measured);

/// The same with the vector part of the quaternion (w >= 0) for the rotation vector, as g2o has it.
RelativePoseTerms quaternion_pose_terms(const SE3& T_world_from, const SE3& T_world_to, const SE3& T_from_to_measured);

/// e = (R_z^T (R_from^T (t_to - t_from) / s_from - t_z), log(R_z^T R_from^T R_to), log(s_to / (s_from s_z))): the rigid
/// part is that of the poses in the unit of `from`, in which the measurement z was made.
RelativeSimilarityTerms relative_similarity_terms(const Sim3& S_world_from, const Sim3& S_world_to,
                                                  const Sim3& S_from_to_measured);

/// Where a camera is on the way between two poses that were solved for: its motion as measured, and of what the motion
/// of the whole way was off, its share.
/// @param share of the way's time, 0 to 1
SE3 motion_on_the_way(const SE3& T_from_camera_measured, const SE3& T_from_to_measured, const SE3& T_from_to,
                      double share);

/// Carries a small motion d made before T over to its end: se3_exp(d) * T = T * se3_exp(transport(T) d) + O(d^2).
Mat6 transport(const SE3& T);
/// Covariance of T^-1 from the covariance of T, both on the right: T * se3_exp(noise).
Mat6 inverse_covariance(const SE3& T, const Mat6& covariance);

/// Whether a covariance is finite, symmetric and positive definite enough to be inverted.
bool is_covariance(const Mat6& covariance);
/// U of |U e|^2 = e^T covariance^-1 e. @param covariance as accepted by is_covariance
Mat6 square_root_information(const Mat6& covariance);

}  // namespace semantic_topo_loop::core
