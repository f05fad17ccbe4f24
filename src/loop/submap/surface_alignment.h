#pragma once

#include <optional>

#include "semantic_topo_loop/types/local_map.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

struct SurfaceAlignment {
  SE3 T_a_b;
  Mat6 covariance = Mat6::Identity();  ///< of T_a_b: (translation m, rotation rad), right perturbation
};

/// Registers b's surfels with a's (symmetric point-to-plane, nearest in place and normal, robust), beginning at an
/// estimate that knows nothing of them, and weighs both by what they know: directions that the surfaces leave free stay
/// as they were.
/// @param a, b with surfels   @param covariance of T_a_b, right perturbation   @return nullopt if too few surfels meet
std::optional<SurfaceAlignment> align_surfaces(const LocalMap& a, const LocalMap& b, const SE3& T_a_b,
                                               const Mat6& covariance);

/// What the check frames of each of two submaps make of the other's surfels.
struct SurfaceAgreement {
  int judged = 0;        ///< surfels that they see, or see through
  int contradicted = 0;  ///< those seen through: they lie well before the surface that is seen along their ray
};

/// @param a, b with surfels
SurfaceAgreement compare_surfaces(const LocalMap& a, const LocalMap& b, const SE3& T_a_b);

}  // namespace semantic_topo_loop::core
