#include "pose_graph/graph_state.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cstddef>
#include <iterator>
#include <numeric>
#include <utility>

#include "geometry/relative_pose.h"

namespace semantic_topo_loop::core {
namespace {

int count_vertices(const GraphState& state) {
  return static_cast<int>(std::count_if(state.keyframes.begin(), state.keyframes.end(),
                                        [](const GraphKeyframe& keyframe) { return !keyframe.T_vertex_keyframe; }));
}

/// As a solution needs it.
bool is_invertible(const Mat6& covariance) {
  return covariance.llt().info() == Eigen::Success && square_root_information(covariance).allFinite();
}

}  // namespace

void GraphState::append(GraphState other) {
  const int vertices = count_vertices(*this);
  sessions.insert(sessions.end(), other.sessions.begin(), other.sessions.end());
  next_frame_id = std::max(next_frame_id, other.next_frame_id);
  if (vertices > 0 && !other.keyframes.empty()) {
    OdometryEdge unknown;
    unknown.is_break = true;
    edges.push_back(unknown);
  }
  std::move(other.edges.begin(), other.edges.end(), std::back_inserter(edges));
  std::move(other.keyframes.begin(), other.keyframes.end(), std::back_inserter(keyframes));
  for (RememberedLoop& loop : other.loops) {
    loop.told.number += accepted_loops;
    if (loop.loop) {
      loop.loop->from += vertices;
      loop.loop->to += vertices;
    }
    loops.push_back(std::move(loop));
  }
  accepted_loops += other.accepted_loops;
  for (OdometryJump& jump : other.noise.jumps) {
    jump.edge += static_cast<std::size_t>(vertices);
    noise.jumps.push_back(jump);
  }
}

std::vector<int> parts_of(const GraphState& state) {
  std::vector<int> segment_of_vertex = {0};
  for (const OdometryEdge& edge : state.edges) {
    segment_of_vertex.push_back(segment_of_vertex.back() + (edge.is_break ? 1 : 0));
  }
  std::vector<int> part(static_cast<std::size_t>(segment_of_vertex.back()) + 1);
  std::iota(part.begin(), part.end(), 0);
  for (const RememberedLoop& loop : state.loops) {
    if (!loop.loop || !loop.is_in_graph || !loop.kept) continue;
    const auto part_of = [&](int vertex) {
      return part[static_cast<std::size_t>(segment_of_vertex[static_cast<std::size_t>(vertex)])];
    };
    const auto [low, high] = std::minmax({part_of(loop.loop->from), part_of(loop.loop->to)});
    if (low != high) std::replace(part.begin(), part.end(), high, low);
  }
  std::vector<int> parts;
  std::size_t vertex = 0;
  for (const GraphKeyframe& keyframe : state.keyframes) {
    if (!keyframe.T_vertex_keyframe && !parts.empty()) ++vertex;
    parts.push_back(part[static_cast<std::size_t>(segment_of_vertex[vertex])]);
  }
  return parts;
}

void put_before(const GraphDelta& earlier, GraphDelta* later) {
  if (later->is_whole) return;
  later->is_whole = earlier.is_whole;
  const auto is_earlier = [](const GraphKeyframe& a, const GraphKeyframe& b) {
    return a.pose.keyframe_id < b.pose.keyframe_id;
  };
  std::vector<GraphKeyframe> keyframes;
  const std::vector<GraphKeyframe>&before = earlier.state.keyframes, &after = later->state.keyframes;
  std::set_union(after.begin(), after.end(), before.begin(), before.end(), std::back_inserter(keyframes), is_earlier);
  later->state.keyframes = std::move(keyframes);
}

Status check(const GraphState& state) {
  const auto is_unordered = [](const GraphKeyframe& p, const GraphKeyframe& q) {
    return p.pose.keyframe_id >= q.pose.keyframe_id;
  };
  const auto& keyframes = state.keyframes;
  const auto unordered = std::adjacent_find(keyframes.begin(), keyframes.end(), is_unordered);
  if (unordered != keyframes.end()) {
    return Error{"keyframe " + std::to_string(unordered->pose.keyframe_id) + " is not before the next one"};
  }
  for (const GraphKeyframe& keyframe : keyframes) {
    if (keyframe.pose.frame_id >= state.next_frame_id) {
      return Error{"keyframe " + std::to_string(keyframe.pose.keyframe_id) + " is of frame " +
                   std::to_string(keyframe.pose.frame_id) + ", but the next frame is " +
                   std::to_string(state.next_frame_id)};
    }
  }
  if (!keyframes.empty() && keyframes.front().T_vertex_keyframe) return Error{"the first keyframe is no vertex"};
  const int vertices = count_vertices(state);
  if (static_cast<int>(state.edges.size()) != std::max(0, vertices - 1)) {
    return Error{std::to_string(state.edges.size()) + " edges do not join " + std::to_string(vertices) + " vertices"};
  }
  for (const RememberedLoop& loop : state.loops) {
    const bool is_fine =
        !loop.loop || (0 <= loop.loop->from && loop.loop->from <= loop.loop->to && loop.loop->to < vertices);
    const std::string name = "loop " + std::to_string(loop.told.number);
    if (!is_fine) return Error{name + " joins vertices that are not there"};
    // One that only repeats others takes the place of those that turn out to be wrong.
    if (loop.loop && !is_invertible(loop.loop->covariance)) {
      return Error{name + " has a covariance that is not positive definite"};
    }
    if (!loop.is_in_graph) continue;
    if (!loop.loop) return Error{name + " has no pose"};
    if (loop.loop->from == loop.loop->to) return Error{name + " joins a vertex with itself"};
  }
  constexpr OdometryNoise kEveryNoise{1.0, 1.0, 0.0, 0.0, 0.0, 1.0};
  for (std::size_t i = 0; i < state.edges.size(); ++i) {
    const OdometryEdge& edge = state.edges[i];
    const Mat6& missed = edge.missed.covariance;
    const bool missed_is_fine = missed.isZero(0.0) || is_invertible(missed);
    const bool is_path = edge.path_m >= 0.0 && edge.rotation_rad >= 0.0;
    if (missed_is_fine && is_path && is_invertible(odometry_covariance(edge, kNoNoise)) &&
        is_invertible(odometry_covariance(edge, kEveryNoise))) {
      continue;
    }
    return Error{"edge " + std::to_string(i) + " has a covariance that is not positive definite, or a negative path"};
  }
  for (const OdometryJump& jump : state.noise.jumps) {
    if (jump.edge >= state.edges.size()) return Error{"a jump is in edge " + std::to_string(jump.edge) + ", not there"};
  }
  return {};
}

}  // namespace semantic_topo_loop::core
