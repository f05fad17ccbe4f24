#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <vector>

#include "odometry/graph_loop.h"
#include "semantic_topo_loop/geometry/quadric.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/landmark.h"

namespace ceres {
class Problem;
}  // namespace ceres

namespace semantic_topo_loop::core {

/// How far away the visible side of an object is.
struct SurfaceDepth {
  Vec3 ray_camera = Vec3::UnitZ();  ///< unit vector from the camera to the object
  double distance_m = 0.0;          ///< of the points seen on the object, along the ray
};

/// One box of an object in a keyframe, in pixels of the image made 640 wide, if it is wider.
struct GraphObjectView {
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
  std::vector<GraphObjectView> views;
};

/// Noise of a box edge, sigma_px + sigma_share * box size, that all boxes share which show an object from about one
/// direction; 0.6 of it each box has by itself.
struct ObjectNoise {
  double sigma_px = 4.0;
  double sigma_share = 0.06;
};

/// Object vertices of one solve.
struct GraphObjects {
  ObjectNoise noise;
  std::vector<GraphObject> objects;
};

/// P = K [R|t] of the view's image.
Mat34 projection_matrix(const GraphObjectView& view, const SE3& T_world_camera);

/// What a view sees of an object: `n` figures and their derivatives.
template <int n>
struct ObjectTerms {
  using Jacobian = Eigen::Matrix<double, n, 3>;
  Eigen::Matrix<double, n, 1> error = Eigen::Matrix<double, n, 1>::Zero();  ///< expected - measured
  Jacobian camera_t = Jacobian::Zero();                                     ///< by the camera's position
  Jacobian camera_rotation = Jacobian::Zero();  ///< by a rotation vector of the camera in the world: R <- exp(w) R
  Jacobian center = Jacobian::Zero();           ///< by the ellipsoid's centre
  Jacobian log_axes = Jacobian::Zero();         ///< by the logarithms of its semi-axes
};

/// Edges of the box, px; those that the image border cuts are 0.
/// @return nullopt if the camera cannot see the ellipsoid
std::optional<ObjectTerms<4>> box_terms(const GraphObjectView& view, const SE3& T_world_camera,
                                        const Ellipsoid& ellipsoid);
/// Distance of the visible side along the ray, m: that of the centre less 0.7 of the ellipsoid's extent, which is the
/// median over a hemisphere's outline.
ObjectTerms<1> depth_terms(const SurfaceDepth& depth, const SE3& T_world_camera, const Ellipsoid& ellipsoid);

/// The objects with at most `max_views` views each, spread evenly. Views in which the ellipsoid at its start does not
/// overlap the box are left out, the poses say that they show something else, and then objects with too few views.
GraphObjects well_seen(const GraphObjects& objects, const std::vector<SE3>& T_world_vertex, int max_views);

/// What the pose graph remembers of the objects: the boxes in its keyframes, and the map's landmarks with their merges.
class ObjectMemory {
 public:
  /// The boxes of a keyframe.
  void add(int vertex, const Camera& camera, const AssociationFrame& associations);
  /// @param vertex_of what a keyframe moves with, by its id; -1 if it is unknown
  /// @param T_map_vertex as they were when the update was made
  void apply(const MapUpdate& update, const std::function<int(std::int64_t)>& vertex_of,
             const std::vector<SE3>& T_map_vertex);
  /// Follows the vertices; what was seen from those that are gone is forgotten. @param carriers one a vertex
  void move(const std::vector<Carrier>& carriers);

  /// The landmarks that are confirmed, in order of id, with all their views: those that merged link all passes that
  /// saw them.
  std::vector<GraphObject> objects() const;
  bool empty() const { return landmarks_.empty(); }

 private:
  struct Sighting {
    std::int64_t landmark_id = -1;  ///< as associated
    GraphObjectView view;
  };

  std::vector<Sighting> sightings_;                ///< in order of the keyframes
  std::map<std::int64_t, GraphObject> landmarks_;  ///< confirmed, without views
  LandmarkRedirects redirects_;
};

/// The objects' unknowns in a problem and what ties them to the keyframes. Must live as long as the problem is solved.
class ObjectBlocks {
 public:
  /// Adds, to a problem that has the vertices, for each view the errors of the box edges, and of the distance of the
  /// visible side where it was measured, over (t, q) of the keyframe, centre, log axes and what views from about the
  /// same direction err by alike; Cauchy loss.
  ObjectBlocks(const GraphObjects& objects, std::vector<SE3>* T_world_vertex, ceres::Problem* problem);

 private:
  struct Unknowns {
    Vec3 center, log_axes;
  };
  /// Of an object, from about one direction: how no ellipsoid has its outline, and what the detector makes of it there.
  struct Aspect {
    Vec3 direction = Vec3::UnitZ();   ///< from the object to the camera, unit vector in the world
    Vec4 edge_errors = Vec4::Zero();  ///< that its views have in common, in sigmas
    double depth_error = 0.0;         ///< likewise
  };
  /// @param to_camera from the object, whose aspects are those from `first` on
  Aspect& aspect(const Vec3& to_camera, std::size_t first, ceres::Problem* problem);

  std::deque<Unknowns> unknowns_;  ///< addresses stay valid
  std::deque<Aspect> aspects_;     ///< likewise
};

}  // namespace semantic_topo_loop::core
