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

/// Residual of a relative similarity and its derivatives by (translation, rotation in the outer frame, log scale).
struct RelativeSimilarityTerms {
  Vec7 residual;  ///< (translation in from's unit, rotation rad, log scale)
  Mat7 J_from, J_to;
};

/// e = (R_z^T (R_from^T (t_to - t_from) / s_from - t_z), log(R_z^T R_from^T R_to), log(s_to / (s_from s_z))): the rigid
/// part is that of relative_pose.h in the unit of `from`, in which the measurement z was made.
Vec7 relative_similarity_residual(const Sim3& S_world_from, const Sim3& S_world_to, const Sim3& S_from_to_measured);
/// The same with its analytic derivatives.
RelativeSimilarityTerms relative_similarity_terms(const Sim3& S_world_from, const Sim3& S_world_to,
                                                  const Sim3& S_from_to_measured);

/// A measured relative similarity between two vertices.
struct SimilarityEdge {
  int from = -1, to = -1;
  Sim3 S_from_to;  ///< its translation in from's unit
  /// U of |U e|^2, e as in RelativeSimilarityTerms; rows of zeros where nothing was measured.
  Mat7 sqrt_info = Mat7::Identity();
  double weight = 1.0;  ///< factor on |U e|^2, >= 0; an edge of weight 0 is left out

  bool is_finite() const { return S_from_to.is_finite(); }
};

/// Minimises 0.5 sum w |U e|^2 over the similarities (Ceres, one thread, Levenberg-Marquardt); `loss` is not used, the
/// fixed vertices keep their scale too.
/// @param S_world_vertex start and result; unchanged unless the solution is usable
GraphSolution solve_similarity_graph(const std::vector<SimilarityEdge>& edges, const GraphSolverOptions& options,
                                     std::vector<Sim3>* S_world_vertex);

}  // namespace semantic_topo_loop::core
