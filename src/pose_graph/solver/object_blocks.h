#pragma once

#include <ceres/ceres.h>

#include <deque>
#include <vector>

#include "pose_graph/solver/graph_object.h"

namespace semantic_topo_loop::core {

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

}  // namespace semantic_topo_loop::core
