#include "pose_graph/solver/segment_placement.h"

#include "geometry/pose_consensus.h"

namespace semantic_topo_loop::core {
namespace {

/// The number of each vertex's segment.
std::vector<std::size_t> segments_of(const Trajectory& trajectory) {
  std::vector<std::size_t> segments(1, 0);
  for (const OdometryEdge& edge : trajectory.edges) segments.push_back(segments.back() + (edge.is_break ? 1 : 0));
  return segments;
}

/// What the loops between a segment and those joined say of the segment's vertices: where each should be (a) and is
/// (b).
std::vector<PosePair> places_of(const Trajectory& trajectory, const std::vector<std::size_t>& segments,
                                std::size_t segment, const std::vector<bool>& joined) {
  std::vector<PosePair> places;
  for (std::size_t k = 0; k < trajectory.loops.size(); ++k) {
    if (!trajectory.votes.empty() && !trajectory.votes[k]) continue;
    const GraphLoop& loop = trajectory.loops[k];
    const auto from = static_cast<std::size_t>(loop.from), to = static_cast<std::size_t>(loop.to);
    const SE3 &T_map_from = trajectory.T_map_vertex[from], &T_map_to = trajectory.T_map_vertex[to];
    if (segments[to] == segment && joined[segments[from]]) places.push_back({T_map_from * loop.T_from_to, T_map_to});
    if (segments[from] == segment && joined[segments[to]]) {
      places.push_back({T_map_to * loop.T_from_to.inverse(), T_map_from});
    }
  }
  return places;
}

}  // namespace

void place_segments(Trajectory* trajectory) {
  const std::vector<std::size_t> segments = segments_of(*trajectory);
  std::vector<bool> joined(segments.back() + 1, false);
  joined[0] = true;
  for (std::size_t round = 1; round < joined.size(); ++round) {
    PoseConsensus best;
    std::size_t next = 0;
    for (std::size_t segment = 1; segment < joined.size(); ++segment) {
      if (joined[segment]) continue;
      const std::vector<PosePair> places = places_of(*trajectory, segments, segment, joined);
      const PoseConsensus placement = most_supported(places, {SE3(), count_supporters(places, SE3())});
      if (next != 0 && placement.supporters <= best.supporters) continue;
      best = placement;
      next = segment;
    }
    joined[next] = true;
    for (std::size_t v = 0; v < segments.size(); ++v) {
      if (segments[v] == next) trajectory->T_map_vertex[v] = best.T_a_b * trajectory->T_map_vertex[v];
    }
  }
}

}  // namespace semantic_topo_loop::core
