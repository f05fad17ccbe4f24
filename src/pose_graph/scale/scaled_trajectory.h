#pragma once

#include <vector>

#include "pose_graph/solver/graph_solver.h"
#include "pose_graph/solver/trajectory_optimizer.h"
#include "semantic_topo_loop/pose_graph/pose_graph_options.h"

namespace semantic_topo_loop::core {

// For an odometry whose unit of length drifts: a chain of keyframes whose edges and loops are in the unit that the
// odometry has at their first vertex. log_scale is that of the map's unit over the odometry's, one a vertex, 0 at the
// first. Steps: estimate_log_scales from what the loops state; scale_votes; then, at these scales, in_map_unit hands a
// rigid trajectory to rejection and noise, and solve_scales solves for poses and scales together.

/// The scales that the loops state along a random walk of the scale, robust against false loops. What no loop
/// reaches keeps the scale of its neighbour.
std::vector<double> estimate_log_scales(const Trajectory& trajectory, const PoseGraphOptions& options);
/// Which loops state a scale that agrees with these.
std::vector<bool> scale_votes(const Trajectory& trajectory, const std::vector<double>& log_scale);
/// The trajectory in the map's unit of length, for all that knows of rigid motions only; the vertices stay.
Trajectory in_map_unit(const Trajectory& trajectory, const std::vector<double>& log_scale);
/// Vertices and scales together (Sim(3)), with the edges and the kept loops of a solution that was found at given
/// scales. The first vertex and its scale stay.
/// @param rigid of in_map_unit(trajectory, *log_scale)
/// @param log_scale start and result   @return whether there is a solution; nothing is changed without
bool solve_scales(const Trajectory& trajectory, const OptimizedTrajectory& rigid, const PoseGraphOptions& options,
                  std::vector<SE3>* T_map_vertex, std::vector<double>* log_scale);
/// |U e|^2 of a loop, its scale included.
double chi_squared(const GraphLoop& loop, const std::vector<SE3>& T_map_vertex, const std::vector<double>& log_scale);

}  // namespace semantic_topo_loop::core
