#pragma once

#include <optional>
#include <vector>

#include "loop/submap/graph_matcher.h"
#include "semantic_topo_loop/loop/loop_options.h"
#include "semantic_topo_loop/types/local_map.h"
#include "semantic_topo_loop/types/loop_closure.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

struct Refinement {
  SE3 T_a_b;
  Mat6 covariance = Mat6::Identity();    ///< of T_a_b: (translation m, rotation rad), right perturbation
  double scale = 1.0;                    ///< factor on b's unit of length, 1 unless the scale is free
  Vec7 scale_covariance = Vec7::Zero();  ///< of log scale with (translation, rotation, log scale), zero unless free
  double median_residual = 0.0;          ///< of the box edges, standard deviations
};

/// Bundle adjustment over two submaps: their relative pose and one spheroid for each pair of matched objects, from the
/// boxes of both sides; with a free scale also the scale of b. The poses within a submap stay as the odometry gave
/// them.
/// @return nullopt if the problem cannot be solved or the pose is not determined
std::optional<Refinement> refine_submaps(const LocalMap& a, const LocalMap& b, const SE3& T_a_b,
                                         const std::vector<NodePair>& pairs, const LoopOptions& options);

/// A closure between the anchors of two submaps, with the evidence's extent; nothing decided yet.
LoopClosure make_closure(const LocalMap& match, const LocalMap& query);
/// Writes down an alignment (a: match, b: query) and the landmarks it pairs.
void set_alignment(const LocalMap& match, const LocalMap& query, const GraphMatch& alignment, LoopClosure* loop);
/// Refines the alignment on boxes, points and surfaces and accepts the loop, or rejects it if the refinement fails or
/// moves it too far, or surfaces contradict it.   @param needs_confirmation reject it, as of too few objects, unless
/// points or surfaces confirm it
void refine_and_decide(const LocalMap& match, const LocalMap& query, const GraphMatch& alignment,
                       bool needs_confirmation, const LoopOptions& options, LoopClosure* loop);

/// Accepts the loop where points of both submaps alone say its pose, as kFoundBySource, and surfaces do not contradict
/// it.
void decide_by_points(const LocalMap& match, const LocalMap& query, LoopClosure* loop);

}  // namespace semantic_topo_loop::core
