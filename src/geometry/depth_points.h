#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "geometry/point_grid.h"
#include "semantic_topo_loop/types/box.h"
#include "semantic_topo_loop/types/camera.h"
#include "semantic_topo_loop/types/eigen.h"

namespace semantic_topo_loop::core {

/// Standard deviation of the depth that a structured-light camera measures at `depth_m`: its disparity has a fixed
/// noise, so that the depth's grows with the square (Khoshelham and Elberink 2012: 1.4 mm at one metre).
inline double depth_sigma_m(double depth_m) { return 1.4e-3 * depth_m * depth_m; }

/// Of a smallest semi-axis, m: boxes that fit loosely make things thicker than they are, and most are thin.
constexpr double kThickest_m = 0.03;
/// How far before the centre of an object its near side is, m, by the smallest semi-axis.
inline double near_side_m(double thickness_m) { return 0.8 * std::min(thickness_m, kThickest_m); }

/// Distance from a plane up to which a point seen by a depth camera counts as lying in it, m.
double plane_tolerance_m(double depth_m);

/// The points x with normal.dot(x) + offset = 0.
struct Plane {
  Vec3 normal = Vec3::UnitZ();  ///< unit
  double offset = 0.0;          ///< m

  double distance(const Vec3& point) const { return normal.dot(point) + offset; }
  /// @param point in the frame of the camera that saw it
  bool holds(const Vec3& point) const { return std::abs(distance(point)) <= plane_tolerance_m(point.z()); }
};

/// The plane that holds most of the points (RANSAC with a fixed seed, then least squares over its inliers).
/// @param points_camera finite, in the frame of the camera that saw them   @param hypotheses planes through three
/// points that are tried   @param min_share of the points that must lie in it
/// @return its normal towards the camera; nullopt if no plane holds so many
std::optional<Plane> dominant_plane(const std::vector<Vec3>& points_camera, int hypotheses, double min_share);

/// A point that a frame saw, and where: undistorted pixel.
struct SeenPoint {
  Vec2 pixel;
  Vec3 point_camera;  ///< m
};

/// The points of one frame, sorted into cells of the image, so that a box finds its own without a look at all others.
class FramePoints {
 public:
  /// Points that are not finite or not in front of the camera are left out.
  FramePoints(const std::vector<Vec3>& points_camera, const Camera& camera);

  const Camera& camera() const { return camera_; }
  /// Those that project into the box, at most about `count_max` of them, evenly taken.
  std::vector<SeenPoint> in(const Box& box, std::size_t count_max) const;

 private:
  Camera camera_;
  PointGrid grid_;
  std::vector<SeenPoint> points_;  ///< in the order of the grid
};

/// The points that may be those of a box's object, by depth: those in the middle of the box about the depth that a
/// third of them do not reach, as far before and behind it as half of the box's longer side is long. Mostly that is the
/// object, since it is in front of what is behind it, holes in it and where depth is missing notwithstanding. Where
/// nearly a third lies farther back and the plane of the nearer ones goes on outside of the box, as that of a desk
/// before a chair, the nearest of the others come second, and one image does not tell which is the object.
/// @param box undistorted, px
/// @return nearest first, each in the camera frame, m; empty if too few points are left
std::vector<std::vector<Vec3>> object_layers(const FramePoints& points, const Box& box);

/// Where depth puts what a box shows, and how large it makes it.
struct Placement {
  Vec3 center = Vec3::Zero();  ///< of the near side, on the ray through the middle of the box; camera frame, m
  double size_m = 0.0;         ///< longer side of the box at that depth
};

/// Whether two places and sizes are those of one thing, whatever it is called: the smaller is more than half of the
/// larger, and they are nearer to each other than 0.4 of the smaller.
bool is_one_thing(const Placement& a, const Placement& b);

/// @param box undistorted, px   @return of each of the object_layers, nearest first
std::vector<Placement> place(const FramePoints& points, const Box& box);

/// The sides of a box at which something in front ends it, as Truncation bits: what lies just inside of them is behind
/// the plane of what lies outside (RANSAC with a fixed seed). Of a chair behind a desk that is the lower side. The
/// object goes on there, so that these sides bound nothing; what an object stands on, and walls behind it, hide none.
/// @param box undistorted, px   @return 0 too where too few points are known
std::uint8_t hidden_sides(const FramePoints& points, const Box& box);

}  // namespace semantic_topo_loop::core
