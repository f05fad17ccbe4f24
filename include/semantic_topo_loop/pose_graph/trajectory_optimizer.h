#pragma once

#include <string>
#include <vector>

#include "semantic_topo_loop/pose_graph/graph_loop.h"
#include "semantic_topo_loop/pose_graph/noise_estimator.h"
#include "semantic_topo_loop/pose_graph/odometry_edge.h"
#include "semantic_topo_loop/pose_graph/pose_graph_options.h"

namespace semantic_topo_loop::core {

/// A chain of keyframes with its loops: edges[i] joins vertices i and i + 1.
struct Trajectory {
  std::vector<SE3> T_map_vertex;
  std::vector<OdometryEdge> edges;
  std::vector<GraphLoop> loops;
};

struct OptimizedTrajectory {
  bool usable = false;
  std::string message;  ///< why it is not usable
  std::vector<SE3> T_map_vertex;
  std::vector<bool> kept;  ///< one a loop
  NoiseEstimate noise;
};

/// Tells right loops from false ones with loose odometry, learns the odometry's noise from the right ones, and solves
/// with those at that noise. The first vertex stays.
/// @param noise of the last optimisation, or what is expected
OptimizedTrajectory optimize_trajectory(const Trajectory& trajectory, const PoseGraphOptions& options,
                                        const NoiseEstimate& noise);

NoisePrior noise_prior(const PoseGraphOptions& options);

}  // namespace semantic_topo_loop::core
