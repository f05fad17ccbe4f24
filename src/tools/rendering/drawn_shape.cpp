#include "tools/rendering/drawn_shape.h"

#include <algorithm>
#include <limits>
#include <map>

namespace semantic_topo_loop::core {
namespace {

// The room: its walls stand clear of the furniture and of the camera's way, which keeps near depth out of the images.
constexpr double kFurnitureGap_m = 0.15;
constexpr double kCameraGap_m = 0.7;
constexpr double kMinHeight_m = 2.6;

/// Grows the box [low, high] so that it holds a disc.
void include(const Vec3& center, double radius, Vec3* low, Vec3* high) {
  *low = low->cwiseMin((center.array() - radius).matrix());
  *high = high->cwiseMax((center.array() + radius).matrix());
}

constexpr double kTableThickness_m = 0.03;
constexpr double kLeg_m = 0.025;  ///< half a side

SE3 at(double x, double y, double z) { return {Quaternion::Identity(), {x, y, z}}; }

/// Of an object of one box (true) or ellipsoid.
std::pair<bool, Paint> plain_shape_of(int class_id) {
  static const std::map<int, std::pair<bool, Paint>> kShapes = {
      {73, {true, Paint::kCover}},       // book
      {66, {true, Paint::kKeys}},        // keyboard
      {65, {true, Paint::kDisplay}},     // remote
      {67, {true, Paint::kDisplay}},     // cell phone
      {74, {true, Paint::kDial}},        // clock
      {39, {false, Paint::kLabel}},      // bottle
      {47, {false, Paint::kPeel}},       // apple
      {49, {false, Paint::kPeel}},       // orange
      {41, {false, Paint::kGlaze}},      // cup
      {45, {false, Paint::kGlaze}},      // bowl
      {75, {false, Paint::kGlaze}},      // vase
      {64, {false, Paint::kDarkMetal}},  // mouse
      {77, {false, Paint::kFur}},        // teddy bear
  };
  const auto shape = kShapes.find(class_id);
  return shape == kShapes.end() ? std::pair(false, Paint::kCloth) : shape->second;
}

struct Shapes {
  std::vector<DrawnShape> all;

  void add_desk(const Desk& desk) {
    add_box(-1, desk.T_world_desk * at(0.0, 0.0, -0.5 * kTableThickness_m),
            {desk.half_depth_m, desk.half_width_m, 0.5 * kTableThickness_m}, Paint::kTableTop);
    const double leg_half = 0.5 * (desk.T_world_desk.t.z() - kTableThickness_m);
    add_legs(-1, desk.T_world_desk, desk.half_depth_m - 0.05, desk.half_width_m - 0.05, -kTableThickness_m - leg_half,
             leg_half);
  }

  void add_object(int index, const SceneObject& object) {
    const Vec3& axes = object.ellipsoid.semi_axes;
    const Vec3 box(kBoxShare * axes.x(), kBoxShare * axes.y(), axes.z());
    switch (object.class_id) {
      case 56:  // chair
        return add_chair(index, box);
      case 62:  // tv
        return add_monitor(index, box);
      case 63:  // laptop
        return add_laptop(index, box);
      case 58:  // potted plant
        return add_plant(index, axes);
    }
    const auto [is_box, paint] = plain_shape_of(object.class_id);
    all.push_back({is_box, index, {}, is_box ? box : axes, paint});
  }

  void add_box(int object, const SE3& T_base_shape, const Vec3& half, Paint paint) {
    all.push_back({true, object, T_base_shape, half, paint});
  }

  /// One at (+-x, +-y) each; z is that of their middle.
  void add_legs(int object, const SE3& T_base, double x, double y, double z, double half) {
    for (const auto& [sx, sy] : {std::pair(-1.0, -1.0), {-1.0, 1.0}, {1.0, -1.0}, {1.0, 1.0}}) {
      add_box(object, T_base * at(sx * x, sy * y, z), {kLeg_m, kLeg_m, half}, Paint::kDarkMetal);
    }
  }

  /// Seat, back at -x, legs.
  void add_chair(int object, const Vec3& box) {
    constexpr double kPlate_m = 0.03;
    const double seat = -0.05 * box.z();
    add_box(object, at(0.0, 0.0, seat), {box.x(), box.y(), kPlate_m}, Paint::kCloth);
    const double back_half = 0.5 * (box.z() - seat);
    add_box(object, at(kPlate_m - box.x(), 0.0, seat + back_half), {kPlate_m, box.y(), back_half}, Paint::kCloth);
    const double leg_half = 0.5 * (seat + box.z());
    add_legs(object, SE3(), box.x() - kLeg_m, box.y() - kLeg_m, leg_half - box.z(), leg_half);
  }

  /// A panel over a foot.
  void add_monitor(int object, const Vec3& box) {
    const double foot_half = 0.12 * box.z();
    const double panel_half = box.z() - foot_half;
    add_box(object, at(0.0, 0.0, foot_half), {0.5 * box.x(), box.y(), panel_half}, Paint::kScreen);
    add_box(object, at(0.0, 0.0, foot_half - box.z()), {box.x(), 0.4 * box.y(), foot_half}, Paint::kDarkMetal);
  }

  /// Keys on the table, a screen upright at -x.
  void add_laptop(int object, const Vec3& box) {
    constexpr double kPlate_m = 0.010;
    add_box(object, at(0.0, 0.0, kPlate_m - box.z()), {box.x(), box.y(), kPlate_m}, Paint::kKeys);
    add_box(object, at(kPlate_m - box.x(), 0.0, 0.0), {kPlate_m, box.y(), box.z()}, Paint::kScreen);
  }

  /// Leaves over a pot, both within the ellipsoid's height.
  void add_plant(int object, const Vec3& axes) {
    const double pot = 0.25 * axes.z();
    const double leaves = axes.z() - pot;
    add_box(object, at(0.0, 0.0, pot - axes.z()), {0.5 * axes.x(), 0.5 * axes.y(), pot}, Paint::kGlaze);
    all.push_back({false, object, at(0.0, 0.0, axes.z() - leaves), {axes.x(), axes.y(), leaves}, Paint::kLeaves});
  }
};

}  // namespace

Room room_around(const Scene& scene, const StampedPoses& camera_path) {
  const SE3& T_world_desk = scene.desks.front().T_world_desk;
  const SE3 T_axes_world = SE3(T_world_desk.q, Vec3::Zero()).inverse();
  Vec3 low = Vec3::Constant(std::numeric_limits<double>::max()), high = -low;
  for (const Desk& desk : scene.desks) {
    include(T_axes_world * desk.T_world_desk.t, std::max(desk.half_depth_m, desk.half_width_m) + kFurnitureGap_m, &low,
            &high);
  }
  for (const SceneObject& object : scene.objects) {
    // Who walks through may come out of a wall.
    if (!object.stays()) continue;
    include(T_axes_world * object.ellipsoid.center(), object.ellipsoid.semi_axes.head<2>().maxCoeff() + kFurnitureGap_m,
            &low, &high);
  }
  for (const StampedPose& pose : camera_path) include(T_axes_world * pose.T_world_camera.t, kCameraGap_m, &low, &high);
  low.z() = 0.0;
  high.z() = std::max(high.z(), kMinHeight_m);
  return {T_axes_world.inverse() * SE3(Quaternion::Identity(), 0.5 * (low + high)), 0.5 * (high - low)};
}

std::vector<DrawnShape> drawn_shapes(const Scene& scene) {
  Shapes shapes;
  for (const Desk& desk : scene.desks) shapes.add_desk(desk);
  for (std::size_t i = 0; i < scene.objects.size(); ++i) shapes.add_object(static_cast<int>(i), scene.objects[i]);
  return std::move(shapes.all);
}

}  // namespace semantic_topo_loop::core
