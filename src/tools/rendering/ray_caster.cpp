#include "tools/rendering/ray_caster.h"

#include <algorithm>
#include <cmath>

namespace semantic_topo_loop::core {
namespace {

constexpr double kNearM = 0.02;

const Box kEverywhere{-1e6, -1e6, 1e6, 1e6};

/// Around the corners; everywhere if the box reaches behind the camera; none if it is wholly behind.
std::optional<Box> box_bounds(const SE3& T_camera_shape, const Vec3& half) {
  Box bounds{1e6, 1e6, -1e6, -1e6};
  int behind = 0;
  for (int i = 0; i < 8; ++i) {
    const Vec3 corner((i & 1) != 0 ? half.x() : -half.x(), (i & 2) != 0 ? half.y() : -half.y(),
                      (i & 4) != 0 ? half.z() : -half.z());
    const Vec3 p = T_camera_shape * corner;
    if (p.z() < kNearM) {
      ++behind;
      continue;
    }
    const Vec2 q = p.hnormalized();
    bounds = {std::min(bounds.x1, q.x()), std::min(bounds.y1, q.y()), std::max(bounds.x2, q.x()),
              std::max(bounds.y2, q.y())};
  }
  if (behind == 8) return std::nullopt;
  return behind > 0 ? kEverywhere : bounds;
}

std::optional<Box> ellipsoid_bounds(const SE3& T_camera_shape, const Vec3& half) {
  Mat34 P = Mat34::Identity();
  const std::optional<Box> bounds = project_box(Ellipsoid{T_camera_shape, half}, P);
  if (bounds) return bounds;
  return T_camera_shape.t.z() + half.maxCoeff() < kNearM ? std::nullopt : std::optional<Box>(kEverywhere);
}

float enter_box(const Eigen::Vector3f& o, const Eigen::Vector3f& d) {
  float entry = -kMiss, exit = kMiss;
  for (int i = 0; i < 3; ++i) {
    const float inverse = 1.0F / d[i];
    const float a = (-1.0F - o[i]) * inverse, b = (1.0F - o[i]) * inverse;
    // A ray within a face gives 0 * infinity, which these comparisons ignore.
    entry = std::max(entry, std::min(a, b));
    exit = std::min(exit, std::max(a, b));
  }
  return entry <= exit && entry > 0.0F ? entry : kMiss;
}

float enter_sphere(const Eigen::Vector3f& o, const Eigen::Vector3f& d) {
  // By the point nearest to the centre: b^2 - a c would lose all digits of a small sphere far away.
  const float a = d.squaredNorm();
  const float middle = -o.dot(d) / a;
  const float rest = 1.0F - (o + middle * d).squaredNorm();
  if (rest <= 0.0F) return kMiss;
  const float depth = middle - std::sqrt(rest / a);
  return depth > 0.0F ? depth : kMiss;
}

}  // namespace

std::optional<CastShape> cast_shape(const DrawnShape& shape, const SE3& T_camera_shape, int index) {
  const std::optional<Box> bounds =
      shape.is_box ? box_bounds(T_camera_shape, shape.half) : ellipsoid_bounds(T_camera_shape, shape.half);
  if (!bounds) return std::nullopt;
  const Vec3 inverse_half = shape.half.cwiseInverse();
  const SE3 T_shape_camera = T_camera_shape.inverse();
  CastShape cast;
  cast.scale = (inverse_half.asDiagonal() * T_shape_camera.rotation()).cast<float>();
  cast.origin = inverse_half.cwiseProduct(T_shape_camera.t).cast<float>();
  cast.R_camera_shape = T_camera_shape.rotation().cast<float>();
  cast.inverse_half = inverse_half.cast<float>();
  cast.is_box = shape.is_box;
  cast.shape = index;
  cast.object = shape.object;
  cast.bounds = *bounds;
  return cast;
}

float depth_of_entry(const CastShape& shape, const Eigen::Vector3f& ray) {
  const Eigen::Vector3f direction = shape.scale * ray;
  return shape.is_box ? enter_box(shape.origin, direction) : enter_sphere(shape.origin, direction);
}

float depth_of_exit(const CastShape& shape, const Eigen::Vector3f& ray) {
  const Eigen::Vector3f direction = shape.scale * ray;
  float exit = kMiss;
  for (int i = 0; i < 3; ++i) {
    if (direction[i] == 0.0F) continue;
    exit = std::min(exit, ((direction[i] > 0.0F ? 1.0F : -1.0F) - shape.origin[i]) / direction[i]);
  }
  return exit;
}

}  // namespace semantic_topo_loop::core
