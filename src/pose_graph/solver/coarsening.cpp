#include "pose_graph/solver/coarsening.h"

#include <algorithm>
#include <limits>
#include <utility>

namespace semantic_topo_loop::core {

Coarsening coarsen(std::size_t size, std::vector<std::size_t>* keyframes, Trajectory* trajectory) {
  std::vector<std::size_t> left(keyframes->size());  // numbers of the vertices that stay
  for (std::size_t v = 0; v < left.size(); ++v) left[v] = v;
  const auto keyframe = [&](std::size_t i) { return (*keyframes)[left[i]]; };
  while (left.size() > std::max<std::size_t>(size, 2)) {
    std::size_t closest = 1;
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t i = 1; i + 1 < left.size(); ++i) {
      const double share =
          static_cast<double>(keyframe(i + 1) - keyframe(i - 1)) / static_cast<double>(keyframes->back() - keyframe(i));
      if (share >= least) continue;
      closest = i;
      least = share;
    }
    left.erase(left.begin() + static_cast<std::ptrdiff_t>(closest));
  }
  Coarsening result;
  Trajectory coarse;
  std::vector<std::size_t> coarse_keyframes;
  for (std::size_t v = 0; v < keyframes->size(); ++v) {
    if (coarse_keyframes.size() < left.size() && v == left[coarse_keyframes.size()]) {
      coarse.T_map_vertex.push_back(trajectory->T_map_vertex[v]);
      coarse_keyframes.push_back((*keyframes)[v]);
      if (v + 1 < keyframes->size()) coarse.edges.push_back(trajectory->edges[v]);
      result.push_back({static_cast<int>(coarse_keyframes.size()) - 1, std::nullopt});
    } else {
      coarse.edges.back() = join(coarse.edges.back(), trajectory->edges[v]);
      result.push_back({static_cast<int>(coarse_keyframes.size()) - 1,
                        coarse.T_map_vertex.back().inverse() * trajectory->T_map_vertex[v]});
    }
  }
  trajectory->T_map_vertex = std::move(coarse.T_map_vertex);
  trajectory->edges = std::move(coarse.edges);
  *keyframes = std::move(coarse_keyframes);
  return result;
}

}  // namespace semantic_topo_loop::core
