#pragma once

#include <optional>
#include <vector>

#include "semantic_topo_loop/geometry/quadric.h"

namespace semantic_topo_loop::core {

/// How far away the visible side of an object is.
struct SurfaceDepth {
  Vec3 ray_camera = Vec3::UnitZ();  ///< unit vector from the camera to the object
  double distance_m = 0.0;          ///< of the points seen on the object, along the ray
};

/// One box of an object in a keyframe.
struct ObjectView {
  int vertex = -1;
  Vec4 intrinsics = Vec4::Zero();  ///< fx, fy, cx, cy, px
  Box box;                         ///< undistorted, px
  std::uint8_t truncated = 0;      ///< Truncation bits: these sides bound nothing
  std::optional<SurfaceDepth> depth;
};

/// An object as a vertex of the graph: an ellipsoid that hangs on a keyframe until it is solved for. Centre and
/// semi-axes are free, its axes keep their directions.
struct GraphObject {
  int anchor = -1;                ///< vertex
  SE3 T_anchor_quadric;           ///< start
  Vec3 semi_axes = Vec3::Ones();  ///< start, m
  std::vector<ObjectView> views;
};

/// What object observations count for.
struct ObjectNoise {
  double weight = 1.0;    ///< factor on the squared errors
  double sigma_px = 4.0;  ///< of a box edge: sigma_px + sigma_share * box size
  double sigma_share = 0.06;
};

/// Object vertices of one solve.
struct GraphObjects {
  ObjectNoise noise;
  std::vector<GraphObject> objects;
};

/// P = K [R|t] of the view's image.
Mat34 projection_matrix(const ObjectView& view, const SE3& T_world_camera);

/// The objects with at most `max_views` views each, spread evenly. Views in which the ellipsoid at its start does not
/// overlap the box are left out, the poses say that they show something else, and then objects with too few views.
GraphObjects well_seen(const GraphObjects& objects, const std::vector<SE3>& T_world_vertex, int max_views);

}  // namespace semantic_topo_loop::core
