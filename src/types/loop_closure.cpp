#include "semantic_topo_loop/types/loop_closure.h"

#include <algorithm>
#include <array>
#include <iterator>

namespace semantic_topo_loop::core {

const char* to_string(LoopReason reason) {
  constexpr std::array<const char*, 14> kNames = {
      "accepted",   "too_few_objects", "too_few_inliers", "too_few_labels", "degenerate",
      "residual",   "ambiguous",       "reprojection",    "mirrored",       "tilt",
      "refinement", "low_score",       "inconsistent",    "outranked"};
  const auto i = static_cast<std::size_t>(reason);
  return i < kNames.size() ? kNames[i] : "unknown";
}

std::vector<LoopClosure> own_loops(const std::vector<LoopClosure>& loops) {
  std::vector<LoopClosure> own;
  std::copy_if(loops.begin(), loops.end(), std::back_inserter(own),
               [](const LoopClosure& loop) { return !loop.T_earlier_match; });
  return own;
}

}  // namespace semantic_topo_loop::core
