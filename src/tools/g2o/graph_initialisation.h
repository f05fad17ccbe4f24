#pragma once

#include <string>
#include <vector>

#include "pose_graph/solver/graph_solver.h"

namespace semantic_topo_loop::core {

/// First guess of a connected graph. The first vertex stays where it is; the edges' loss is not used.
/// - "odometry": along the edges i -> i + 1; what they do not reach, along the fewest edges.
/// - "spanning_tree": along the fewest edges from the first vertex.
/// - "chordal": chordal relaxation (Martinec and Pajdla 2007; Carlone et al. 2015): rotations as the least-squares
///   solution over all matrices, projected onto the rotations, then the positions, which are linear. Edges count by the
///   mean of their information and by their weight. The spanning tree where a linear system cannot be solved.
std::vector<SE3> first_guess(const std::string& kind, const std::vector<GraphEdge>& edges,
                             const std::vector<SE3>& T_world_vertex);

}  // namespace semantic_topo_loop::core
