#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "odometry/graph_loop.h"
#include "odometry/noise_estimator.h"
#include "odometry/odometry_edge.h"
#include "semantic_topo_loop/types/map_correction.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// An accepted loop, as the graph remembers it.
struct RememberedLoop {
  LoopVerdict told;  ///< what was said of it last
  bool is_told = false;
  std::optional<GraphLoop> loop;  ///< none if it was refused
  std::string refusal;
  bool is_in_graph = false;           ///< not if it was refused or repeats others
  bool may_vote = true, kept = true;  ///< of those in the graph
  bool is_settled = false;            ///< believed when an earlier session ended: its clusters were doubted then
};

/// A keyframe and what it moves with.
struct GraphKeyframe {
  KeyframePose pose;
  std::optional<SE3> T_vertex_keyframe;  ///< from the last vertex before it; none: it is one itself
  /// Of the camera as it was told when the keyframe was made, before any correction by it or later ones, in the map as
  /// it was then; none in files of before.
  std::optional<SE3> T_map_live;
};

/// One run of a robot. Ids go on from one session to the next.
struct Session {
  std::int64_t first_keyframe_id = 0;
  std::int64_t begin_ns = 0, end_ns = 0;  ///< stamps of its first keyframe and its last frame
};

/// All that a later session needs of a pose graph to go on with it.
struct GraphState {
  std::vector<Session> sessions;  ///< in order of their keyframes
  std::int64_t next_frame_id = 0;
  std::vector<GraphKeyframe> keyframes;  ///< in order of id; the first is a vertex
  std::vector<OdometryEdge> edges;       ///< edges[i] joins vertices i and i + 1
  std::vector<RememberedLoop> loops;     ///< in order of acceptance
  std::int64_t accepted_loops = 0;       ///< so far, forgotten ones too
  NoiseEstimate noise;
  double loose_factor = 0.0;  ///< see GraphKnowledge

  std::int64_t next_keyframe_id() const { return keyframes.empty() ? 0 : keyframes.back().pose.keyframe_id + 1; }
  /// Adds a graph about which nothing is known but its own frame: numbers of vertices, edges and loops are raised to
  /// what follows, and a break leads to it. Ids are as they come.
  void append(GraphState other);
};

/// Numbers of the parts of a graph, by keyframe: what odometry without a break and kept loops join is one.
std::vector<int> parts_of(const GraphState& state);

/// What is new in a pose graph.
struct GraphDelta {
  bool is_whole = false;  ///< and not new only
  /// All but its keyframes, which are many: of these the new ones, vertices that moved (not what only moves with one),
  /// and those that move with another vertex than before.
  GraphState state;
};

/// Makes of a delta the one of both. @param earlier that before it
void put_before(const GraphDelta& earlier, GraphDelta* later);

/// @return an error that names what does not fit together
Status check(const GraphState& state);

}  // namespace semantic_topo_loop::core
