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
  /// First vertex of each session, whose odometry has errors of its own that last; this session's is the last.
  std::vector<int> session_begins{0};
  /// Other motions, which take the places of `edges` in the solution if the loops bear them out better, as one that
  /// starts afresh finds out; or none.
  std::vector<OdometryEdge> measured;
  std::vector<GraphLoop> loops;
  std::vector<bool> votes;  ///< one a loop: whether it counts, see LoopConsistency; empty: all do
  GraphObjects objects;     ///< take part in the last solve, once loops and odometry have been settled
};

/// What an optimisation found out, the warm start of the next one.
struct GraphKnowledge {
  NoiseEstimate noise;
  bool prefers_measured = false;  ///< whether Trajectory::measured are the better motions
  double loose_factor = 0.0;      ///< on the least noise, at which loops are classified; 0: not known yet
  std::vector<bool> kept;         ///< one a loop; loops beyond its end are new
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

/// The odometry as a solution at what is known takes it: without the errors that were found in it, and with the
/// covariance of what is left, as if its source stated that. So another odometry may go on from there, whose noise is
/// its own. As it is, where loops lead over less than half of it and so tell little of its noise.
std::vector<OdometryEdge> settled_odometry(const Trajectory& trajectory, const PoseGraphOptions& options,
                                           const GraphKnowledge& knowledge);

/// Of the loops that are kept those between whose ends there is noise to be learnt; all where there is none anywhere.
/// @param kept one a loop
std::vector<bool> telling_loops(const Trajectory& trajectory, const std::vector<bool>& kept);

NoisePrior noise_prior(const PoseGraphOptions& options);
/// The least noise by default, in which is stated what no odometry needs, whatever the options say of this one.
OdometryNoise usual_least_noise(const PoseGraphOptions& options);

/// Leaves out vertices until `size` are left, and joins the odometry over them, its noise as it was. The past comes in
/// steps that are a share of its age: what goes is the vertex whose neighbours are closest, in keyframes, in relation
/// to how many keyframes came since. So a run of any length fits into a graph of one size, and of a correction that a
/// new loop distributes over the past at most that share falls between two neighbours. The first and the last vertex
/// stay, and the first after a break of the odometry: what comes then does not move with what was before. Where breaks
/// alone are too many, so it does if no loop has told where it belongs.
/// @param has_loops one a vertex: whether loops end there
/// @param keyframes number of each vertex's keyframe, ascending   @param trajectory its loops are not looked at
/// @return what each vertex moves with: the last before it that stayed, by its new number
std::vector<Carrier> coarsen(std::size_t size, const std::vector<bool>& has_loops, std::vector<std::size_t>* keyframes,
                             Trajectory* trajectory);

}  // namespace semantic_topo_loop::core
