#pragma once

#include <vector>

#include "pose_graph/solver/graph_solver.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// A measured relative similarity between two vertices.
struct SimilarityEdge {
  int from = -1, to = -1;
  Sim3 S_from_to;  ///< its translation in from's unit
  /// U of |U e|^2, e as in relative_similarity.h; rows of zeros where nothing was measured.
  Mat7 sqrt_info = Mat7::Identity();
  double weight = 1.0;  ///< factor on |U e|^2, >= 0; an edge of weight 0 is left out
};

/// Minimises 0.5 sum w |U e|^2 over the similarities (Ceres, one thread, Levenberg-Marquardt); `loss` is not used, the
/// fixed vertices keep their scale too.
/// @param S_world_vertex start and result; unchanged unless the solution is usable
GraphSolution solve_similarity_graph(const std::vector<SimilarityEdge>& edges, const GraphSolverOptions& options,
                                     std::vector<Sim3>* S_world_vertex);

}  // namespace semantic_topo_loop::core
