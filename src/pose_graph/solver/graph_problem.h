#pragma once

#include <ceres/ceres.h>

#include <algorithm>
#include <deque>
#include <string>
#include <vector>

#include "pose_graph/solver/graph_objects.h"
#include "pose_graph/solver/graph_solver.h"

// What the Ceres problems of graphs over poses and over similarities share.
namespace semantic_topo_loop::core {

/// @return with the message of Ceres; usable as far as Ceres can tell
GraphSolution solve_problem(const GraphSolverOptions& options, ceres::Problem* problem);

/// The objects' unknowns in a problem and what ties them to the keyframes. Must live as long as the problem is solved.
class ObjectBlocks {
 public:
  /// Adds, to a problem that has the vertices, for each view the errors of the box edges, and of the distance of the
  /// visible side where it was measured, over (t, q) of the keyframe, centre and log axes; Cauchy loss.
  ObjectBlocks(const GraphObjects& objects, std::vector<SE3>* T_world_vertex, ceres::Problem* problem);

 private:
  struct Unknowns {
    Vec3 center, log_axes;
  };
  std::deque<Unknowns> unknowns_;  ///< addresses stay valid
};

template <class Vertex>
bool all_finite(const std::vector<Vertex>& vertices) {
  return std::all_of(vertices.begin(), vertices.end(), [](const Vertex& vertex) { return vertex.is_finite(); });
}

/// @return the first fault that would make every residual meaningless, or an empty text
template <class Edge, class Vertex>
std::string graph_fault(const std::vector<Edge>& edges, const std::vector<int>& fixed,
                        const std::vector<Vertex>& vertices) {
  const auto is_known = [n = static_cast<int>(vertices.size())](int v) { return v >= 0 && v < n; };
  if (vertices.empty()) return "no vertex";
  if (fixed.empty()) return "no vertex is fixed";
  if (!all_finite(vertices)) return "a vertex is not finite";
  if (!std::all_of(fixed.begin(), fixed.end(), is_known)) return "a fixed vertex is unknown";
  for (const Edge& edge : edges) {
    const bool is_joined = is_known(edge.from) && is_known(edge.to) && edge.from != edge.to;
    if (is_joined && edge.is_finite() && edge.sqrt_info.allFinite() && edge.weight >= 0.0) continue;
    return "edge " + std::to_string(edge.from) + " to " + std::to_string(edge.to) +
           " is not finite or joins no two vertices";
  }
  return {};
}

/// Takes over a solution; not even the rounding of the fixed vertices changes.
template <class Vertex>
void accept(std::vector<Vertex> result, const std::vector<int>& fixed, std::vector<Vertex>* vertices) {
  for (const int v : fixed) result[static_cast<std::size_t>(v)] = (*vertices)[static_cast<std::size_t>(v)];
  *vertices = std::move(result);
}

}  // namespace semantic_topo_loop::core
