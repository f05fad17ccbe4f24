#include "semantic_topo_loop/pose_graph/graph_loop.h"

#include <algorithm>

#include "semantic_topo_loop/pose_graph/relative_pose.h"

namespace semantic_topo_loop::core {
namespace {

double interval_overlap(std::int64_t a_begin, std::int64_t a_end, std::int64_t b_begin, std::int64_t b_end) {
  const std::int64_t shared = std::min(a_end, b_end) - std::max(a_begin, b_begin) + 1;
  const std::int64_t all = std::max(a_end, b_end) - std::min(a_begin, b_begin) + 1;
  return shared > 0 ? static_cast<double>(shared) / static_cast<double>(all) : 0.0;
}

const char* fault(const LoopClosure& closure, int query_vertex, int match_vertex) {
  if (query_vertex < 0) return "its query keyframe is unknown";
  if (match_vertex < 0) return "its match keyframe is unknown";
  if (query_vertex == match_vertex) return "its keyframes are the same";
  if (!closure.T_match_query.is_finite()) return "its pose is not finite";
  constexpr double kMaxNormError = 1e-3;
  if (std::abs(closure.T_match_query.q.norm() - 1.0) > kMaxNormError) return "its quaternion is not of unit length";
  if (!is_covariance(closure.covariance)) return "its covariance is not positive definite";
  return nullptr;
}

}  // namespace

std::optional<GraphLoop> make_graph_loop(const LoopClosure& closure, int query_vertex, int match_vertex,
                                         std::string* error) {
  if (const char* why = fault(closure, query_vertex, match_vertex)) {
    *error = "loop of keyframes " + std::to_string(closure.query_keyframe_id) + " and " +
             std::to_string(closure.match_keyframe_id) + " refused: " + why;
    return std::nullopt;
  }
  GraphLoop loop;
  loop.query_keyframe_id = closure.query_keyframe_id;
  loop.match_keyframe_id = closure.match_keyframe_id;
  const bool has_windows = closure.query_begin >= 0 && closure.query_end >= closure.query_begin &&
                           closure.match_begin >= 0 && closure.match_end >= closure.match_begin;
  loop.query_begin = has_windows ? closure.query_begin : closure.query_frame;
  loop.query_end = has_windows ? closure.query_end : closure.query_frame;
  loop.match_begin = has_windows ? closure.match_begin : closure.match_frame;
  loop.match_end = has_windows ? closure.match_end : closure.match_frame;
  const SE3 T_match_query(closure.T_match_query.q.normalized(), closure.T_match_query.t);
  const bool forward = match_vertex < query_vertex;
  loop.from = forward ? match_vertex : query_vertex;
  loop.to = forward ? query_vertex : match_vertex;
  loop.T_from_to = forward ? T_match_query : T_match_query.inverse();
  loop.covariance = forward ? closure.covariance : inverse_covariance(T_match_query, closure.covariance);
  return loop;
}

double shared_evidence(const GraphLoop& a, const GraphLoop& b) {
  return interval_overlap(a.query_begin, a.query_end, b.query_begin, b.query_end) *
         interval_overlap(a.match_begin, a.match_end, b.match_begin, b.match_end);
}

std::vector<double> redundancy(const std::vector<GraphLoop>& loops, const std::vector<bool>& counts) {
  std::vector<double> sums(loops.size(), 1.0);
  const auto is_in = [&counts](std::size_t i) { return counts.empty() || counts[i]; };
  for (std::size_t i = 0; i < loops.size(); ++i) {
    for (std::size_t j = 0; j < i && is_in(i); ++j) {
      if (!is_in(j)) continue;
      const double shared = shared_evidence(loops[i], loops[j]);
      sums[i] += shared;
      sums[j] += shared;
    }
  }
  return sums;
}

}  // namespace semantic_topo_loop::core
