#pragma once

#include <vector>

#include "pose_graph/solver/graph_solver.h"

namespace semantic_topo_loop::core {

struct LoopClassification {
  bool usable = false;
  std::vector<bool> kept;           ///< one a loop edge, in their order
  std::vector<SE3> T_world_vertex;  ///< the poses at which it was decided
  int solves = 0;
};

/// Tells right loops from false ones by graduated non-convexity with truncated least squares (Yang et al. 2020): the
/// cost min(|U e|^2, chi2) of each loop, reached from its convex surrogate through a series of weighted solves.
/// @param edges odometry edges and loop edges; those flagged robust are classified, their weight is a factor
/// @param guess of each loop edge: if a solve with the guessed ones alone bears it out, it stands. Without a guess, or
///        if it fails, all are judged anew
LoopClassification classify_loops(const std::vector<GraphEdge>& edges, double chi2, const GraphSolverOptions& options,
                                  const std::vector<SE3>& T_world_vertex, const std::vector<bool>& guess = {});

}  // namespace semantic_topo_loop::core
