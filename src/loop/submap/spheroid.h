#pragma once

#include <optional>
#include <vector>

#include "semantic_topo_loop/types/local_map.h"

namespace semantic_topo_loop::core {

/// Box edges (x1, y1, x2, y2) of a projected spheroid on the plane z = 1, with derivatives.
struct SpheroidProjection {
  Vec4 edges;
  Eigen::Matrix<double, 4, 3> d_center;  ///< by the centre in the camera frame
  Eigen::Matrix<double, 4, 3> d_axis;    ///< by the axis in the camera frame
  Eigen::Matrix<double, 4, 2> d_log_axes;
};

/// Projects with C* = M - c c^T, M = a^2 I + (b^2 - a^2) w w^T (the dual conic of a spheroid in the camera frame).
/// @param axis_camera unit   @return nullopt if the spheroid touches or lies behind the plane z = 0
std::optional<SpheroidProjection> project_spheroid(const Vec3& center_camera, const Vec3& axis_camera,
                                                   const Vec2& log_axes);
/// The box alone.
std::optional<Box> spheroid_box(const Vec3& center_camera, const Vec3& axis_camera, const Vec2& log_axes);

/// Puts 0 for the sides that are cut.
void leave_out_cut(const SubmapView& view, Vec4* weights);

/// Standard deviation of a view's depth of the object's centre, m; only where it has one.
double depth_sigma_m(const SubmapView& view);

struct SpheroidFit {
  Spheroid spheroid;
  Mat3 center_covariance = Mat3::Identity();  ///< m^2
};

/// Fits a spheroid about the submap's up direction to the boxes of an object, and to the depths of its centre where
/// frames tell them, from a centre near its own.
/// @return nullopt if a view cannot see it or the fit fails
std::optional<SpheroidFit> fit_spheroid(const LocalMap& map, const std::vector<SubmapView>& views, const Vec3& center);

}  // namespace semantic_topo_loop::core
