#pragma once

#include <algorithm>
#include <optional>
#include <vector>

#include "semantic_topo_loop/types/camera.h"
#include "semantic_topo_loop/types/landmark.h"

namespace semantic_topo_loop::core {

/// One box of an object and the camera that saw it.
struct BoxView {
  SE3 T_world_camera;
  Box box;                     ///< undistorted, px
  std::uint8_t truncated = 0;  ///< Truncation bits: these sides bound nothing
  double near_m = 0.0;         ///< depth of the near side, in the middle of the box; 0 where it is not known

  double depth(const Vec3& point_world) const {
    return (T_world_camera.q.conjugate() * (point_world - T_world_camera.t)).z();
  }
};

struct QuadricFitOptions {
  int max_iterations = 12;  ///< of a fit that is repeated as views come in
  double sigma_px = 3.0;    ///< noise of a box edge: sigma_px (of an image 640 wide) + sigma_share * size
  double sigma_share = 0.1;
  double roundness_weight = 0.01;        ///< pull of the three log axes to their common start, per view
  double near_roundness_weight = 0.002;  ///< the same, per view with depth, which does not leave the distance open
  double near_sigma_m = 0.01;            ///< of the near side's depth, beside the camera's noise
  double near_share = 0.1;               ///< the same, as a share of the ellipsoid's radius
  double near_share_cut = 0.5;           ///< the same, where the box is cut: of what is slanted it shows one end
};

/// An ellipsoid with the evidence of its fit.
struct QuadricFit {
  Ellipsoid ellipsoid;
  Mat3 center_covariance = Mat3::Zero();  ///< m^2
  double mean_iou = 0.0;                  ///< of projected and detected boxes, clipped to the image
  double median_depth_m = 0.0;
};

/// Refines all nine parameters on the box edges: residual (projected edge - detected edge) / sigma, soft-L1 loss a
/// view, sides cut by the image border left out (Ceres, Levenberg-Marquardt). Where a view has depth, the object
/// reaches at least to where its box is cut, and there is one more residual, (depth of the centre - 0.8 smallest
/// semi-axis - depth of the near side) / sigma, Cauchy loss: a ball's near side is 0.8 radii before its centre in the
/// mean over the middle, and that of what is flat, seen at whatever slant, in the centre.
/// @return nullopt if the solver finds no usable solution
std::optional<QuadricFit> refine_quadric(const Camera& camera, const std::vector<BoxView>& views,
                                         const Ellipsoid& initial, const QuadricFitOptions& options = {});

/// Depths at which a ray enters and leaves an ellipsoid, in lengths of its direction; of a ray that misses it, both are
/// where it passes the centre.
struct RayDepths {
  double enters = 0.0, leaves = 0.0;
};
/// @return nullopt if the ellipsoid is behind the origin of the ray or around it
std::optional<RayDepths> ray_depths(const Ellipsoid& ellipsoid, const Vec3& origin, const Vec3& direction);

}  // namespace semantic_topo_loop::core
