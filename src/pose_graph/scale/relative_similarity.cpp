#include "pose_graph/scale/relative_similarity.h"

#include <cmath>

#include "geometry/relative_pose.h"

namespace semantic_topo_loop::core {
namespace {

/// The pose of `to` that has, with a scale of 1, the relative pose that it has in the unit of `from`.
SE3 in_unit_of_from(const Sim3& S_world_from, const SE3& T_world_to) {
  const Vec3& t_from = S_world_from.T.t;
  return {T_world_to.q, t_from + (T_world_to.t - t_from) / S_world_from.scale};
}

}  // namespace

Vec7 relative_similarity_residual(const Sim3& S_world_from, const Sim3& S_world_to, const Sim3& S_from_to_measured) {
  Vec7 residual;
  residual << relative_pose_residual(S_world_from.T, in_unit_of_from(S_world_from, S_world_to.T), S_from_to_measured.T),
      std::log(S_world_to.scale / (S_world_from.scale * S_from_to_measured.scale));
  return residual;
}

RelativeSimilarityTerms relative_similarity_terms(const Sim3& S_world_from, const Sim3& S_world_to,
                                                  const Sim3& S_from_to_measured) {
  const SE3 T_world_to = in_unit_of_from(S_world_from, S_world_to.T);
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
  terms.J_from.topRightCorner<3, 1>() = -by_step * (T_world_to.t - S_world_from.T.t);
  terms.J_from(6, 6) = -1.0;
  terms.J_to(6, 6) = 1.0;
  return terms;
}

}  // namespace semantic_topo_loop::core
