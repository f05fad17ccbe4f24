#pragma once

#include <vector>

#include "pose_graph/solver/trajectory_optimizer.h"
#include "semantic_topo_loop/pose_graph/pose_graph_options.h"

namespace semantic_topo_loop::core {

/// Which of the kept loops stay if the clusters that strain the odometry most are doubted: one goes if, given the other
/// loops and an odometry as noisy, drifting or jumping as all of them together bear out best, it is less likely than
/// false loops that may state any pose. Agreement among its own loops helps it only as far as they are evidence of
/// their own. The worst goes first.
/// @param knowledge of the last optimisation of this trajectory
std::vector<bool> without_surprising_clusters(Trajectory trajectory, const PoseGraphOptions& options,
                                              GraphKnowledge knowledge);

}  // namespace semantic_topo_loop::core
