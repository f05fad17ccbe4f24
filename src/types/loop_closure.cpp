#include "semantic_topo_loop/types/loop_closure.h"

#include <array>
#include <cmath>

#include "semantic_topo_loop/types/eigen.h"

namespace semantic_topo_loop::core {

const char* to_string(LoopReason reason) {
  constexpr std::array<const char*, 16> kNames = {
      "accepted",     "too_few_objects", "too_few_inliers", "too_few_labels", "degenerate", "residual",
      "ambiguous",    "reprojection",    "mirrored",        "tilt",           "refinement", "low_score",
      "inconsistent", "outranked",       "contradicted",    "found_by_source"};
  const auto i = static_cast<std::size_t>(reason);
  return i < kNames.size() ? kNames[i] : "unknown";
}

void LoopFigures::state_sigmas(const Mat6& covariance) {
  sigma_m = std::sqrt(covariance.topLeftCorner<3, 3>().trace());
  sigma_deg = degrees(std::sqrt(covariance.bottomRightCorner<3, 3>().trace()));
}

bool is_finite(const LoopFigures& loop) {
  bool is_fine = is_rotation(loop.T_match_query.q) && loop.T_match_query.is_finite();
  visit_fields(loop, [&is_fine](const char*, const auto& field) {
    if constexpr (std::is_same_v<decltype(field), const double&>) is_fine = is_fine && std::isfinite(field);
  });
  return is_fine;
}

}  // namespace semantic_topo_loop::core
