#pragma once

#include "loop/graph/graph_matcher.h"
#include "loop/graph/local_map.h"
#include "loop/graph/submap_refiner.h"
#include "semantic_topo_loop/loop/loop_options.h"
#include "semantic_topo_loop/types/loop_closure.h"

namespace semantic_topo_loop::core {

/// A closure between the anchors of two submaps, with the evidence's extent; nothing decided yet.
LoopClosure make_closure(const LocalMap& match, const LocalMap& query);
/// Writes down an alignment (a: match, b: query) and the landmarks it pairs.
void set_alignment(const LocalMap& match, const LocalMap& query, const GraphMatch& alignment, LoopClosure* loop);
/// Refines the alignment on boxes and accepts the loop, or rejects it if the refinement fails or moves it too far.
void refine_and_decide(const LocalMap& match, const LocalMap& query, const GraphMatch& alignment,
                       const SubmapRefiner& refiner, const LoopOptions& options, LoopClosure* loop);

}  // namespace semantic_topo_loop::core
