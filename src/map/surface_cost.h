#pragma once

#include <ceres/cost_function.h>

#include <optional>
#include <vector>

#include "map/quadric_fit.h"

namespace semantic_topo_loop::core {

/// Depth at which a ray meets an ellipsoid, with its derivatives as in BoxJacobian.
struct RayDepth {
  double depth = 0.0;  ///< in lengths of the ray's direction
  Vec3 by_center = Vec3::Zero(), by_rotation = Vec3::Zero(), by_log_axes = Vec3::Zero();
};

/// A ray that passes near the outline or misses it is taken to end a little before its closest approach to the centre,
/// so that the depth goes on smoothly.
/// @return nullopt if the ellipsoid is behind the origin of the ray or around it
std::optional<RayDepth> surface_depth(const Ellipsoid& ellipsoid, const Vec3& origin, const Vec3& direction);

/// Standard deviation of one view's depth against an ellipsoid of the given radius.
double surface_sigma_m(const BoxView& view, double radius_m, const QuadricFitOptions& options);

/// r = (depth of the ellipsoid - measured depth) / (sigma sqrt(number of points)) over centre, rotation (Eigen
/// quaternion) and log semi-axes.
class SurfaceCost final : public ceres::CostFunction {
 public:
  /// @param view has a surface
  SurfaceCost(const BoxView& view, double sigma_m);
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

 private:
  struct Ray {
    Vec3 direction_world;  ///< depth 1
    double depth;          ///< measured, m
  };
  Vec3 origin_;
  std::vector<Ray> rays_;
  double weight_;
};

}  // namespace semantic_topo_loop::core
