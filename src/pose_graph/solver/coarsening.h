#pragma once

#include <cstddef>
#include <vector>

#include "pose_graph/solver/trajectory_optimizer.h"

namespace semantic_topo_loop::core {

/// What each vertex of a chain moves with once some were left out: the last before it that stayed, by its new number.
using Coarsening = std::vector<Carrier>;

/// Leaves out vertices until `size` are left, and joins the odometry over them, its noise as it was. The past comes in
/// steps that are a share of its age: what goes is the vertex whose neighbours are closest, in keyframes, in relation
/// to how many keyframes came since. So a run of any length fits into a graph of one size, and of a correction that a
/// new loop distributes over the past at most that share falls between two neighbours. The first and the last vertex
/// stay.
/// @param keyframes number of each vertex's keyframe, ascending   @param trajectory its loops are not looked at
Coarsening coarsen(std::size_t size, std::vector<std::size_t>* keyframes, Trajectory* trajectory);

}  // namespace semantic_topo_loop::core
