#pragma once

#include <ceres/ceres.h>

#include <deque>
#include <vector>

#include "semantic_topo_loop/pose_graph/graph_object.h"

namespace semantic_topo_loop::core {

/// The objects' unknowns in a problem and what ties them to the keyframes. Must live as long as the problem is solved.
class ObjectBlocks {
 public:
  /// Adds, to a problem that has the vertices, for each view the box edges (projected - seen) / sigma over (t, q) of
  /// the keyframe, centre and log axes, and the distance of the visible side where it was measured; Cauchy loss.
  ObjectBlocks(const GraphObjects& objects, std::vector<SE3>* T_world_vertex, ceres::Problem* problem);

 private:
  struct Unknowns {
    Vec3 center, log_axes;
  };
  std::deque<Unknowns> unknowns_;  ///< addresses stay valid
};

/// Box edges of one view: residual (projected - seen) / sigma over (t, q, centre, log axes).
/// @param axes directions of the ellipsoid's axes in the world
ceres::CostFunction* make_box_cost(const ObjectView& view, const Quaternion& axes, double sigma_px);
/// Distance of the visible side of an ellipsoid, by the mean over its outline 2/3 of its extent before the centre.
ceres::CostFunction* make_depth_cost(const ObjectView& view, const Quaternion& axes, double sigma_m);

}  // namespace semantic_topo_loop::core
