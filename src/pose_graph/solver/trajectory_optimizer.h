#pragma once

#include <vector>

#include "odometry/graph_loop.h"
#include "odometry/noise_estimator.h"
#include "odometry/odometry_edge.h"
#include "pose_graph/solver/graph_objects.h"
#include "pose_graph/solver/graph_solver.h"
#include "semantic_topo_loop/pose_graph/pose_graph_options.h"

namespace semantic_topo_loop::core {

/// A chain of keyframes with its loops: edges[i] joins vertices i and i + 1.
struct Trajectory {
  std::vector<SE3> T_map_vertex;
  std::vector<OdometryEdge> edges;
  std::vector<GraphLoop> loops;
  std::vector<bool> votes;  ///< one a loop: whether it counts, see LoopConsistency; empty: all do
  GraphObjects objects;     ///< take part in the last solve, once loops and odometry have been settled
};

/// What an optimisation found out, the warm start of the next one.
struct GraphKnowledge {
  NoiseEstimate noise;
  double loose_factor = 0.0;  ///< on the least noise, at which loops are classified; 0: not known yet
  std::vector<bool> kept;     ///< one a loop; loops beyond its end are new
};

struct OptimizedTrajectory {
  bool usable = false;
  std::vector<SE3> T_map_vertex;
  GraphKnowledge knowledge;
  std::vector<GraphEdge> edges;  ///< of the last solve: the odometry's, then the loops
};

enum class Effort {
  kUpdate,    ///< trusts what is known: two solves, unless new loops contradict it
  kLearn,     ///< learns the odometry's noise anew
  kFull,      ///< and doubts every loop anew
  kClassify,  ///< doubts every loop anew, and does no more
  kSettle     ///< trusts the loops that are kept, and makes everything else from these alone
};

/// Tells right loops from false ones with loose odometry, learns the odometry's noise from the right ones, and solves
/// with those at that noise. The first vertex stays.
/// @param knowledge of the last optimisation, or what is expected
OptimizedTrajectory optimize_trajectory(const Trajectory& trajectory, const PoseGraphOptions& options,
                                        const GraphKnowledge& knowledge, Effort effort);

NoisePrior noise_prior(const PoseGraphOptions& options);

}  // namespace semantic_topo_loop::core
