#pragma once

#include <limits>
#include <optional>
#include <vector>

#include "tools/rendering/drawn_shape.h"

namespace semantic_topo_loop::core {

/// A shape as the rays of one camera meet it: the unit cube or unit sphere after p_camera -> scale * p_camera + origin.
struct CastShape {
  Eigen::Matrix3f scale = Eigen::Matrix3f::Identity();
  Eigen::Vector3f origin = Eigen::Vector3f::Zero();
  Eigen::Matrix3f R_camera_shape = Eigen::Matrix3f::Identity();
  Eigen::Vector3f inverse_half = Eigen::Vector3f::Ones();
  bool is_box = true;
  int shape = -1;   ///< index of the drawn shape
  int object = -1;  ///< of that shape
  Box bounds;       ///< holds every ray (x, y, 1) that can hit

  Eigen::Vector3f point(const Eigen::Vector3f& ray, float depth) const { return depth * (scale * ray) + origin; }
  /// Unit normal in the camera frame at a point of the surface (in units of `half`) and its face, outwards.
  Eigen::Vector3f normal(const Eigen::Vector3f& point, Face face) const {
    if (!is_box) return (R_camera_shape * point.cwiseProduct(inverse_half)).normalized();
    const Eigen::Vector3f axis = R_camera_shape.col(face / 2);
    return face % 2 == 0 ? axis : Eigen::Vector3f(-axis);
  }
};

/// @return nullopt if no part of the shape lies in front of the camera
std::optional<CastShape> cast_shape(const DrawnShape& shape, const SE3& T_camera_shape, int index);

/// A ray has z = 1, so that the distance in its lengths is the depth. Infinity if it misses.
constexpr float kMiss = std::numeric_limits<float>::infinity();
float depth_of_entry(const CastShape& shape, const Eigen::Vector3f& ray);
/// Where a ray leaves a box that it starts in.
float depth_of_exit(const CastShape& shape, const Eigen::Vector3f& ray);

}  // namespace semantic_topo_loop::core
