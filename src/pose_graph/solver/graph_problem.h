#pragma once

#include <ceres/solver.h>

#include "pose_graph/solver/graph_solver.h"

namespace semantic_topo_loop::core {

/// Derivative of the quaternion (x, y, z, w) by a small rotation of the outer frame, times two.
Eigen::Matrix<double, 4, 3> quaternion_by_rotation(const Quaternion& q);
/// What every solve of a graph is run with.
ceres::Solver::Options ceres_options(const GraphSolverOptions& options);

}  // namespace semantic_topo_loop::core
