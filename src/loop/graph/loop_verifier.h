#pragma once

#include <optional>

#include "loop/submap/graph_matcher.h"
#include "semantic_topo_loop/loop/loop_options.h"
#include "semantic_topo_loop/types/local_map.h"
#include "semantic_topo_loop/types/loop_closure.h"

namespace semantic_topo_loop::core {

/// How well one submap's objects, moved by an alignment, explain the other submap's detections.
struct Reprojection {
  double ratio = 0.0;  ///< matched over expected boxes; expected ones are weighed by how often the object is detected
  int objects = 0;     ///< objects matched in more than 30 % of the frames that should see them
  double explained = 0.0;  ///< share of the detections that an object explains
};

struct Verdict {
  LoopReason reason = LoopReason::kAccepted;
  double tilt_deg = 0.0;                     ///< between the two up directions, 0 if one of them is uncertain
  std::optional<Reprojection> reprojection;  ///< each figure the worse of both ways; none if a test before it failed
};

/// The acceptance tests of an alignment between two submaps: enough objects and classes, spread out and well aligned,
/// no alternative nearly as good, not mirrored, upright, and each side's detections explained by the other side's
/// objects.
/// @param second_score of the best distinct alternative   @return the first test that fails, or kAccepted
Verdict verify_alignment(const LocalMap& a, const LocalMap& b, const GraphMatch& match, double second_score,
                         const LoopOptions& options);
/// True if the two submaps' cameras lie on different sides of the plane through the matched objects: then one is the
/// mirror image of the other, which no residual shows.
bool is_mirrored(const LocalMap& a, const LocalMap& b, const GraphMatch& match);
/// Angle between the two up directions, rad; 0 if one of them is uncertain.
double tilt(const LocalMap& a, const LocalMap& b, const SE3& T_a_b);

}  // namespace semantic_topo_loop::core
