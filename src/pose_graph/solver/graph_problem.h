#pragma once

#include <ceres/solver.h>

#include "pose_graph/solver/graph_solver.h"

namespace semantic_topo_loop::core {

/// What every solve of a graph is run with.
ceres::Solver::Options ceres_options(const GraphSolverOptions& options);

}  // namespace semantic_topo_loop::core
