#pragma once

#include <vector>

#include "pose_graph/solver/graph_solver.h"

namespace semantic_topo_loop::core {

/// First guesses of a connected graph. The first vertex stays where it is; an edge's sqrt_info and weight are used
/// where it says so, the loss is not.

/// Along the edges i -> i + 1; what they do not reach, along the fewest edges.
std::vector<SE3> odometry_guess(const std::vector<GraphEdge>& edges, const std::vector<SE3>& T_world_vertex);
/// Along the fewest edges from the first vertex.
std::vector<SE3> spanning_tree_guess(const std::vector<GraphEdge>& edges, const std::vector<SE3>& T_world_vertex);
/// Chordal relaxation (Martinec and Pajdla 2007; Carlone et al. 2015): rotations as the least-squares solution over all
/// matrices, projected onto the rotations, then the positions, which are linear. Edges count by the mean of their
/// information.
/// @return the spanning tree's guess where a linear system cannot be solved
std::vector<SE3> chordal_guess(const std::vector<GraphEdge>& edges, const std::vector<SE3>& T_world_vertex);

}  // namespace semantic_topo_loop::core
