#pragma once

#include "pose_graph/solver/trajectory_optimizer.h"

namespace semantic_topo_loop::core {

/// Puts each segment of the trajectory, which ends where the odometry breaks, to where its loops have it: a solver that
/// starts from a segment that lies anywhere, turned by any angle, does not find its way. Segments join the first one in
/// order of how many loops agree; each moves as it is, by the loop that most loops into those already joined agree
/// with, and stays if as many agree with where it is. One without such loops stays too.
/// @param trajectory with loops and votes
void place_segments(Trajectory* trajectory);

}  // namespace semantic_topo_loop::core
