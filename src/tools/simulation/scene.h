#pragma once

#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "semantic_topo_loop/geometry/quadric.h"
#include "semantic_topo_loop/types/camera.h"
#include "semantic_topo_loop/types/option_visitor.h"

namespace semantic_topo_loop::core {

struct SceneOptions {
  std::string layout = "desk";
  int desks = 3;
  bool identical_desks = false;
  int seed = -1;

  int desk_count() const { return layout == "desk" ? 1 : desks; }
  void visit(OptionVisitor& visitor) {
    visitor.module("scene");
    visitor("layout", layout, one_of({"desk", "office", "house"}),
            "desk (one large desk), office (a row of desks) or house (a row of rooms with a large desk in each, which "
            "hide each other's objects; rendered images show no walls between them)");
    visitor("desks", desks, between(1, 50), "office, house: number of desks");
    visitor("identical_desks", identical_desks,
            "office, house: every desk carries the same objects at the same places");
    visitor("seed", seed, at_least(-1),
            "of desks, objects and their looks, for sequences of several robots in one scene; -1: simulation.seed");
  }
};

/// A stretch of an object's life; it ends when the next one begins.
struct ObjectPhase {
  double begin_s = 0.0;          ///< from the first image
  bool is_present = true;        ///< false: not in the room
  SE3 T_world_object;            ///< at begin_s
  Vec3 velocity = Vec3::Zero();  ///< world frame, m/s
};

/// A labelled object. Its z axis is vertical.
struct SceneObject {
  int class_id = -1;                ///< COCO, 0..79
  Ellipsoid ellipsoid;              ///< of an object that moves: where it is at last
  std::vector<ObjectPhase> phases;  ///< in order of time; empty: always at rest

  /// Where it is at a time; nullopt if it is not in the room then.
  std::optional<Ellipsoid> at(double time_s) const;
  /// True if it is in the room, at rest, from some time to the end.
  bool stays() const { return phases.empty() || (phases.back().is_present && phases.back().velocity.isZero()); }
};

/// A rectangular table top; x is its depth (front at +x), y its width, z up, origin in the middle of the surface.
struct Desk {
  SE3 T_world_desk;
  double half_depth_m = 0.0;
  double half_width_m = 0.0;
};

/// A room, or rooms in a row, in a z-up world whose floor is z = 0.
struct Scene {
  std::vector<Desk> desks;
  std::vector<SceneObject> objects;
  double room_length_m = 0.0;  ///< along the row of desks, each in the middle of its room; 0: one room

  int room_of(const Vec3& p_world) const;
};

/// Lays out desks and fills them with objects of plausible sizes. Every object rests on a table top or on the floor,
/// and no two overlap (their footprints keep a gap); an object that finds no free place is left out.
Scene make_scene(const SceneOptions& options, std::uint64_t seed);

constexpr double kFootprintGap_m = 0.02;  ///< kept between footprints

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
  constexpr double kMargin = 0.5 * kFootprintGap_m;
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

/// What a camera sees of an ellipsoid without a detector's errors.
struct ObjectView {
  Box whole;             ///< raw (distorted) pixels, not clipped; far outside the image only roughly right
  Box box;               ///< the same around the unoccluded part, clipped to the image
  double visible = 0.0;  ///< share of the outline's area inside the image that nothing nearer hides, [0, 1]
  double inside = 0.0;   ///< share of `whole` that lies in the image, [0, 1]
};

/// Projects ellipsoids with occlusion by other ellipsoids and table tops.
class SceneProjector {
 public:
  /// @param scene must outlive the projector
  SceneProjector(const Scene& scene, const Camera& camera);

  /// @param time_s from the first image; where nothing moves, any
  /// @return one view an object, in order of Scene::objects; none if the object is behind or outside the image, or not
  ///         in the room
  std::vector<std::optional<ObjectView>> project(const SE3& T_world_camera, double time_s = 0.0) const;
  /// The raw box around an ellipsoid, not clipped and not occluded.
  std::optional<Box> raw_box(const Ellipsoid& ellipsoid, const SE3& T_world_camera) const;

 private:
  const Scene* scene_;
  Camera camera_;
  Box undistorted_image_;  ///< where the lens model is known to hold
};

}  // namespace semantic_topo_loop::core
