#pragma once

#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// Residual of a relative similarity and its derivatives by (translation, rotation in the outer frame, log scale).
struct RelativeSimilarityTerms {
  Vec7 residual;  ///< (translation in from's unit, rotation rad, log scale)
  Mat7 J_from, J_to;
};

/// e = (R_z^T (R_from^T (t_to - t_from) / s_from - t_z), log(R_z^T R_from^T R_to), log(s_to / (s_from s_z))): the rigid
/// part is that of relative_pose.h in the unit of `from`, in which the measurement z was made.
Vec7 relative_similarity_residual(const Sim3& S_world_from, const Sim3& S_world_to, const Sim3& S_from_to_measured);
/// The same with its analytic derivatives.
RelativeSimilarityTerms relative_similarity_terms(const Sim3& S_world_from, const Sim3& S_world_to,
                                                  const Sim3& S_from_to_measured);

}  // namespace semantic_topo_loop::core
