#include "loop/graph/loop_evidence.h"

#include <cmath>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {

LoopClosure make_closure(const LocalMap& match, const LocalMap& query) {
  LoopClosure loop;
  loop.query_keyframe_id = query.keyframe_id;
  loop.match_keyframe_id = match.keyframe_id;
  loop.query_frame = query.frame_id;
  loop.match_frame = match.frame_id;
  loop.query_stamp_ns = query.stamp_ns;
  loop.match_stamp_ns = match.stamp_ns;
  loop.query_begin = query.begin_frame;
  loop.query_end = query.end_frame;
  loop.match_begin = match.begin_frame;
  loop.match_end = match.end_frame;
  if (match.is_earlier) loop.T_earlier_match = match.T_odom_anchor;
  return loop;
}

void set_alignment(const LocalMap& match, const LocalMap& query, const GraphMatch& alignment, LoopClosure* loop) {
  loop->rms_m = alignment.rms_m;
  loop->spread_m = alignment.spread_m(1);
  loop->inliers = static_cast<int>(alignment.pairs.size());
  loop->labels = alignment.classes;
  loop->T_match_query = alignment.T_a_b;
  loop->scale = alignment.scale;
  loop->matches.clear();
  for (const NodePair& pair : alignment.pairs) {
    loop->matches.push_back({query.objects[static_cast<std::size_t>(pair.b)].landmark_id,
                             match.objects[static_cast<std::size_t>(pair.a)].landmark_id});
  }
}

void refine_and_decide(const LocalMap& match, const LocalMap& query, const GraphMatch& alignment,
                       const SubmapRefiner& refiner, const LoopOptions& options, LoopClosure* loop) {
  loop->reason = LoopReason::kRefinement;
  const std::optional<Refinement> refined = refiner.refine(match, query, alignment.T_a_b, alignment.pairs);
  if (!refined) return;
  loop->refine_residual = refined->median_residual;
  loop->refine_shift_m = (alignment.T_a_b.inverse() * refined->T_a_b).t.norm();
  loop->refine_shift_deg = degrees(rotation_angle(alignment.T_a_b.q, refined->T_a_b.q));
  loop->sigma_m = std::sqrt(refined->covariance.topLeftCorner<3, 3>().trace());
  loop->sigma_deg = degrees(std::sqrt(refined->covariance.bottomRightCorner<3, 3>().trace()));
  if (loop->refine_residual > options.refine_max_residual || loop->refine_shift_m > options.refine_max_shift_m ||
      loop->refine_shift_deg > options.refine_max_shift_deg) {
    return;
  }
  loop->T_match_query = refined->T_a_b;
  loop->covariance = refined->covariance;
  loop->scale *= refined->scale;
  loop->scale_covariance = refined->scale_covariance;
  if (loop->sigma_m > options.max_sigma_m || loop->sigma_deg > options.max_sigma_deg) return;
  loop->reason = LoopReason::kAccepted;
  loop->accepted = true;
}

}  // namespace semantic_topo_loop::core
