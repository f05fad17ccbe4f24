#pragma once

#include <cmath>
#include <limits>
#include <optional>
#include <random>
#include <vector>

#include "geometry/depth_points.h"
#include "semantic_topo_loop/geometry/quadric.h"
#include "semantic_topo_loop/types/camera.h"

namespace semantic_topo_loop::core::testing {

/// Ellipsoids on a table that is 2 m x 2 m at z = 0, above a floor at z = -0.7; what a depth camera sees of them.
struct DepthScene {
  std::vector<Ellipsoid> objects;
  double noise = 1.0;  ///< of depth, in Kinect's
  int stride_px = 4;

  std::vector<Vec3> look(const Camera& camera, const SE3& T_world_camera, std::uint64_t seed = 1) const {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal(0.0, 1.0);
    std::vector<Vec3> points;
    for (int v = stride_px / 2; v < camera.height; v += stride_px) {
      for (int u = stride_px / 2; u < camera.width; u += stride_px) {
        const Vec3 ray = camera.ray(Vec2(u, v));
        const std::optional<double> depth = hit(T_world_camera, ray);
        if (depth) points.push_back(ray * (*depth + noise * depth_sigma_m(*depth) * normal(random)));
      }
    }
    return points;
  }

  std::optional<double> hit(const SE3& T_world_camera, const Vec3& ray_camera) const {
    const Vec3 ray = T_world_camera.q * ray_camera;
    double nearest = std::numeric_limits<double>::infinity();
    for (const double level : {0.0, -0.7}) {
      const double t = (level - T_world_camera.t.z()) / ray.z();
      const Vec3 at = T_world_camera.t + t * ray;
      const bool is_inside = level < 0.0 || (std::abs(at.x()) < 1.0 && std::abs(at.y()) < 1.0);
      if (t > 0.0 && is_inside) nearest = std::min(nearest, t);
    }
    for (const Ellipsoid& object : objects) {
      const SE3 T_object_camera = object.T_world_quadric.inverse() * T_world_camera;
      const Vec3 o = T_object_camera.t.cwiseQuotient(object.semi_axes);
      const Vec3 d = (T_object_camera.q * ray_camera).cwiseQuotient(object.semi_axes);
      const double a = d.squaredNorm(), b = o.dot(d), c = o.squaredNorm() - 1.0;
      if (b * b < a * c) continue;
      const double t = (-b - std::sqrt(b * b - a * c)) / a;
      if (t > 0.0) nearest = std::min(nearest, t);
    }
    return std::isfinite(nearest) && nearest < 8.0 ? std::optional<double>(nearest) : std::nullopt;
  }
};

/// An ellipsoid that stands on the table.
inline Ellipsoid on_table(double x, double y, const Vec3& semi_axes, double yaw = 0.0) {
  return {SE3(Quaternion(Eigen::AngleAxisd(yaw, Vec3::UnitZ())), Vec3(x, y, semi_axes.z())), semi_axes};
}

}  // namespace semantic_topo_loop::core::testing
