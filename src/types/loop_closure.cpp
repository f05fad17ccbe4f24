#include "semantic_topo_loop/types/loop_closure.h"

#include <array>

namespace semantic_topo_loop::core {

const char* to_string(LoopReason reason) {
  constexpr std::array<const char*, 15> kNames = {
      "accepted",   "too_few_objects", "too_few_inliers", "too_few_labels", "degenerate",
      "residual",   "ambiguous",       "reprojection",    "mirrored",       "tilt",
      "refinement", "low_score",       "inconsistent",    "outranked",      "contradicted"};
  const auto i = static_cast<std::size_t>(reason);
  return i < kNames.size() ? kNames[i] : "unknown";
}

}  // namespace semantic_topo_loop::core
