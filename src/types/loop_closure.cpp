#include "semantic_topo_loop/types/loop_closure.h"

#include <algorithm>
#include <iterator>

namespace semantic_topo_loop::core {

const char* to_string(LoopReason reason) {
  switch (reason) {
    case LoopReason::kAccepted:
      return "accepted";
    case LoopReason::kTooFewObjects:
      return "too_few_objects";
    case LoopReason::kTooFewInliers:
      return "too_few_inliers";
    case LoopReason::kTooFewLabels:
      return "too_few_labels";
    case LoopReason::kDegenerate:
      return "degenerate";
    case LoopReason::kResidual:
      return "residual";
    case LoopReason::kAmbiguous:
      return "ambiguous";
    case LoopReason::kReprojection:
      return "reprojection";
    case LoopReason::kMirrored:
      return "mirrored";
    case LoopReason::kTilt:
      return "tilt";
    case LoopReason::kRefinement:
      return "refinement";
    case LoopReason::kLowScore:
      return "low_score";
    case LoopReason::kInconsistent:
      return "inconsistent";
    case LoopReason::kOutranked:
      return "outranked";
  }
  return "unknown";
}

std::vector<LoopClosure> own_loops(const std::vector<LoopClosure>& loops) {
  std::vector<LoopClosure> own;
  std::copy_if(loops.begin(), loops.end(), std::back_inserter(own),
               [](const LoopClosure& loop) { return !loop.T_earlier_match; });
  return own;
}

}  // namespace semantic_topo_loop::core
