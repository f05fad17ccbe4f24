#include "pose_graph/solver/segment_placement.h"

#include <algorithm>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kAgreement_m = 0.5;        ///< three times the largest sigma of an accepted loop (loop.max_sigma_m)
constexpr double kAgreement_rad = 0.26;     ///< 15 deg, three times loop.max_sigma_deg
constexpr std::size_t kMaxHypotheses = 50;  ///< loops whose supporters are counted, spread evenly

/// What a loop says of a vertex: where it is, and where it should be.
struct Place {
  SE3 T_map_vertex, T_map_expected;
};

struct Placement {
  SE3 T_new_old;
  std::size_t supporters = 0;  ///< loops that agree with it
};

std::size_t count_supporters(const std::vector<Place>& places, const SE3& T_new_old) {
  const auto agrees = [&T_new_old](const Place& place) {
    const SE3 T_map_vertex = T_new_old * place.T_map_vertex;
    return (T_map_vertex.t - place.T_map_expected.t).norm() < kAgreement_m &&
           rotation_angle(T_map_vertex.q, place.T_map_expected.q) < kAgreement_rad;
  };
  return static_cast<std::size_t>(std::count_if(places.begin(), places.end(), agrees));
}

Placement most_supported(const std::vector<Place>& places) {
  Placement best{SE3(), count_supporters(places, SE3())};
  for (std::size_t i = 0; i < places.size(); i += 1 + places.size() / kMaxHypotheses) {
    const SE3 T_new_old = places[i].T_map_expected * places[i].T_map_vertex.inverse();
    const std::size_t supporters = count_supporters(places, T_new_old);
    if (supporters > best.supporters) best = {T_new_old, supporters};
  }
  return best;
}

/// The number of each vertex's segment.
std::vector<std::size_t> segments_of(const Trajectory& trajectory) {
  std::vector<std::size_t> segments(1, 0);
  for (const OdometryEdge& edge : trajectory.edges) segments.push_back(segments.back() + (edge.is_break ? 1 : 0));
  return segments;
}

/// What the loops between a segment and those joined say of the segment's vertices.
std::vector<Place> places_of(const Trajectory& trajectory, const std::vector<std::size_t>& segments,
                             std::size_t segment, const std::vector<bool>& joined) {
  std::vector<Place> places;
  for (std::size_t k = 0; k < trajectory.loops.size(); ++k) {
    if (!trajectory.votes.empty() && !trajectory.votes[k]) continue;
    const GraphLoop& loop = trajectory.loops[k];
    const auto from = static_cast<std::size_t>(loop.from), to = static_cast<std::size_t>(loop.to);
    const SE3 &T_map_from = trajectory.T_map_vertex[from], &T_map_to = trajectory.T_map_vertex[to];
    if (segments[to] == segment && joined[segments[from]]) places.push_back({T_map_to, T_map_from * loop.T_from_to});
    if (segments[from] == segment && joined[segments[to]]) {
      places.push_back({T_map_from, T_map_to * loop.T_from_to.inverse()});
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
    Placement best;
    std::size_t next = 0;
    for (std::size_t segment = 1; segment < joined.size(); ++segment) {
      if (joined[segment]) continue;
      const Placement placement = most_supported(places_of(*trajectory, segments, segment, joined));
      if (next != 0 && placement.supporters <= best.supporters) continue;
      best = placement;
      next = segment;
    }
    joined[next] = true;
    for (std::size_t v = 0; v < segments.size(); ++v) {
      if (segments[v] == next) trajectory->T_map_vertex[v] = best.T_new_old * trajectory->T_map_vertex[v];
    }
  }
}

}  // namespace semantic_topo_loop::core
