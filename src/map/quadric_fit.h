#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "geometry/depth_points.h"
#include "semantic_topo_loop/types/camera.h"
#include "semantic_topo_loop/types/landmark.h"

namespace semantic_topo_loop::core {

/// One box of an object and the camera that saw it.
struct BoxView {
  SE3 T_world_camera;
  Box box;                                 ///< undistorted, px
  std::uint8_t truncated = 0;              ///< Truncation bits: these sides bound nothing
  std::shared_ptr<const Surface> surface;  ///< what depth there was inside the box; null without

  double depth(const Vec3& point_world) const {
    return (T_world_camera.q.conjugate() * (point_world - T_world_camera.t)).z();
  }
};

struct QuadricFitOptions {
  int max_iterations = 12;  ///< of a fit that is repeated as views come in
  double sigma_px = 3.0;    ///< noise of a box edge: sigma_px + sigma_share * box size
  double sigma_share = 0.1;
  double roundness_weight = 0.01;  ///< pull of the three log axes to their common start, per view
  double surface_sigma_m = 0.01;   ///< of depth against the ellipsoid, beside the camera's noise: no object is one
  double surface_share = 0.15;     ///< the same, as a share of the ellipsoid's radius
};

/// An ellipsoid with the evidence of its fit.
struct QuadricFit {
  Ellipsoid ellipsoid;
  Mat3 center_covariance = Mat3::Zero();  ///< m^2
  double mean_iou = 0.0;                  ///< of projected and detected boxes, clipped to the image
  double median_depth_m = 0.0;
};

/// Refines all nine parameters on the box edges: residual (projected edge - detected edge) / sigma, soft-L1 loss a
/// view, sides cut by the image border left out (Ceres, Levenberg-Marquardt). Where a view has a surface, also on its
/// depth: residual (depth of the ellipsoid along the ray - measured depth) / sigma, Cauchy loss a view; the points of
/// one view share one error, that of the shape, and count as one measurement.
/// @return nullopt if the solver finds no usable solution
std::optional<QuadricFit> refine_quadric(const Camera& camera, const std::vector<BoxView>& views,
                                         const Ellipsoid& initial, const QuadricFitOptions& options = {});

/// Depth at which a ray meets an ellipsoid, with its derivatives as in BoxJacobian.
struct RayDepth {
  double depth = 0.0;  ///< in lengths of the ray's direction
  Vec3 by_center = Vec3::Zero(), by_rotation = Vec3::Zero(), by_log_axes = Vec3::Zero();
};

/// A ray that passes near the outline or misses it is taken to end a little before its closest approach to the centre,
/// so that the depth goes on smoothly.
/// @return nullopt if the ellipsoid is behind the origin of the ray or around it
std::optional<RayDepth> surface_depth(const Ellipsoid& ellipsoid, const Vec3& origin, const Vec3& direction);

}  // namespace semantic_topo_loop::core
