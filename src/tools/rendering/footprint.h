#pragma once

#include <cmath>

#include "tools/simulation/scene.h"

namespace semantic_topo_loop::core {

constexpr double kFootprintGapM = 0.02;  ///< kept between footprints

/// Upright box around an object, seen from above.
struct Footprint {
  Vec2 center;
  Vec2 x_axis, y_axis;  ///< unit
  Vec2 half;

  double reach(const Vec2& direction) const {
    return half.x() * std::abs(x_axis.dot(direction)) + half.y() * std::abs(y_axis.dot(direction));
  }
};

/// With half the gap around it.
inline Footprint footprint(const SE3& T_world_box, double half_x, double half_y) {
  const Mat3 R = T_world_box.rotation();
  constexpr double kMargin = 0.5 * kFootprintGapM;
  return {T_world_box.t.head<2>(), R.col(0).head<2>(), R.col(1).head<2>(), {half_x + kMargin, half_y + kMargin}};
}

inline Footprint footprint(const Ellipsoid& ellipsoid) {
  return footprint(ellipsoid.T_world_quadric, ellipsoid.semi_axes.x(), ellipsoid.semi_axes.y());
}

/// Separating axes of two rectangles.
inline bool disjoint(const Footprint& a, const Footprint& b) {
  const Vec2 offset = b.center - a.center;
  for (const Vec2& axis : {a.x_axis, a.y_axis, b.x_axis, b.y_axis}) {
    if (std::abs(offset.dot(axis)) > a.reach(axis) + b.reach(axis)) return true;
  }
  return false;
}

/// True if an object of these semi-axes stands wholly on the table top.
inline bool stands_on(const Desk& desk, const SE3& T_desk_object, const Vec3& axes) {
  const Footprint print = footprint(T_desk_object, axes.x(), axes.y());
  return std::abs(print.center.x()) + print.reach(Vec2::UnitX()) <= desk.half_depth_m &&
         std::abs(print.center.y()) + print.reach(Vec2::UnitY()) <= desk.half_width_m;
}

inline SE3 upright_pose(const Vec3& position, double yaw) {
  return {Quaternion(Eigen::AngleAxisd(yaw, Vec3::UnitZ())), position};
}

}  // namespace semantic_topo_loop::core
