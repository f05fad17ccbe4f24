#pragma once

#include <optional>
#include <vector>

#include "semantic_topo_loop/types/loop_closure.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// An accepted loop between two vertices, the earlier one first.
struct GraphLoop {
  int from = -1, to = -1;
  SE3 T_from_to;
  Mat6 covariance = Mat6::Identity();    ///< right: (translation m, rotation rad)
  double scale = 1.0;                    ///< of from's unit of length over to's, see LoopClosure
  Vec7 scale_covariance = Vec7::Zero();  ///< of log scale with (translation, rotation, log scale); zero: not measured
  std::int64_t query_keyframe_id = -1, match_keyframe_id = -1;
  bool had_support = false;  ///< another loop that agreed with it has been forgotten
  std::int64_t query_begin = -1, query_end = -1, match_begin = -1, match_end = -1;  ///< frame_ids of the evidence

  bool has_scale() const { return scale_covariance(6) > 0.0; }
  Sim3 S_from_to() const { return Sim3(T_from_to, scale); }
};

/// U of |U e|^2 with e of relative_similarity_terms; its last row is zero if the scale was not measured.
Mat7 similarity_sqrt_info(const GraphLoop& loop);

/// @param query_vertex, match_vertex vertices of the two keyframes
/// @return an error that names the loop and the fault if it cannot be an edge
Result<GraphLoop> make_graph_loop(const LoopClosure& closure, int query_vertex, int match_vertex);

/// What a keyframe moves with.
struct Carrier {
  int vertex = -1;
  std::optional<SE3> T_vertex_keyframe;  ///< none if the vertex is the keyframe itself
};

/// The loop between the vertices that its ends move with, which may be one.
GraphLoop carried(GraphLoop loop, const Carrier& from, const Carrier& to);

/// How much two loops rest on the same evidence: the overlap of their query windows times that of their match windows,
/// each as intersection over union, in [0, 1].
double shared_evidence(const GraphLoop& a, const GraphLoop& b);

/// For each loop the sum of the evidence it shares with all that count (itself included), >= 1: n copies of a loop each
/// count 1/n.
/// @param counts one a loop; empty: all do
std::vector<double> redundancy(const std::vector<GraphLoop>& loops, const std::vector<bool>& counts = {});

/// Loops that share evidence with each other, directly or through others: one visit of one place. In order of their
/// first loop.
/// @param counts one a loop: which of them are grouped
std::vector<std::vector<std::size_t>> loop_clusters(const std::vector<GraphLoop>& loops,
                                                    const std::vector<bool>& counts);

/// At most `count` of the loops that are kept, evenly taken. @param kept one a loop
std::vector<GraphLoop> some_kept(const std::vector<GraphLoop>& loops, const std::vector<bool>& kept, std::size_t count);

/// Squared error of a loop at the given poses, in sigmas as it states them.
double chi_squared(const GraphLoop& loop, const std::vector<SE3>& T_map_vertex);

}  // namespace semantic_topo_loop::core
