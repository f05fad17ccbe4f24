#pragma once

#include <optional>
#include <vector>

#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// A similarity p_a = scale * (T.q * p_b) + T.t, with the evidence of its fit.
struct Alignment {
  SE3 T_a_b;
  double scale = 1.0;
  double rms_m = 0.0;                   ///< root mean square of the residuals, m
  Mat3 covariance_b_m2 = Mat3::Zero();  ///< of the b points, m^2

  /// Singular values of the centred b points / sqrt(n), descending, m.
  Vec3 spread_m() const;
};

/// Closed-form least-squares alignment of corresponding points (Umeyama 1991).
/// @return nullopt for fewer than 3 pairs, mismatched sizes, non-finite input or points on one line
std::optional<Alignment> align_points(const std::vector<Vec3>& points_a, const std::vector<Vec3>& points_b,
                                      bool with_scale = false);

}  // namespace semantic_topo_loop::core
