#include "loop_evidence.h"

#include <cmath>

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
  return loop;
}

void set_alignment(const LocalMap& match, const LocalMap& query, const GraphMatch& alignment, LoopClosure* loop) {
  loop->rms_m = alignment.rms_m;
  loop->inliers = static_cast<int>(alignment.pairs.size());
  loop->labels = alignment.classes;
  loop->T_match_query = alignment.T_a_b;
  loop->matches.clear();
  for (const NodePair& pair : alignment.pairs) {
    loop->matches.push_back({query.objects[static_cast<std::size_t>(pair.b)].landmark_id,
                             match.objects[static_cast<std::size_t>(pair.a)].landmark_id});
  }
}

namespace {

bool moved_too_far(const SE3& before, const SE3& after, const LoopOptions& options) {
  return (before.inverse() * after).t.norm() > options.refine_max_shift_m ||
         rotation_angle(before.q, after.q) > radians(options.refine_max_shift_deg);
}

bool is_vague(const Mat6& covariance, const LoopOptions& options) {
  return std::sqrt(covariance.topLeftCorner<3, 3>().trace()) > options.max_sigma_m ||
         std::sqrt(covariance.bottomRightCorner<3, 3>().trace()) > radians(options.max_sigma_deg);
}

}  // namespace

void refine_and_decide(const LocalMap& match, const LocalMap& query, const GraphMatch& alignment,
                       const SubmapRefiner& refiner, const LoopOptions& options, LoopClosure* loop) {
  loop->reason = LoopReason::kRefinement;
  const std::optional<Refinement> refined = refiner.refine(match, query, alignment.T_a_b, alignment.pairs);
  if (!refined || refined->median_residual > options.refine_max_residual ||
      moved_too_far(alignment.T_a_b, refined->T_a_b, options)) {
    return;
  }
  loop->T_match_query = refined->T_a_b;
  loop->covariance = refined->covariance;
  if (is_vague(refined->covariance, options)) return;
  loop->reason = LoopReason::kAccepted;
  loop->accepted = true;
}

}  // namespace semantic_topo_loop::core
