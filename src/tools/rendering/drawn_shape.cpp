#include "tools/rendering/drawn_shape.h"

#include <algorithm>
#include <cmath>

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

/// An object of one box or ellipsoid.
struct PlainShape {
  int class_id;
  bool is_box;
  Paint paint;
};

const PlainShape& plain_shape_of(int class_id) {
  static const PlainShape kShapes[] = {
      {73, true, Paint::kCover},       // book
      {66, true, Paint::kKeys},        // keyboard
      {65, true, Paint::kDisplay},     // remote
      {67, true, Paint::kDisplay},     // cell phone
      {74, true, Paint::kDial},        // clock
      {39, false, Paint::kLabel},      // bottle
      {47, false, Paint::kPeel},       // apple
      {49, false, Paint::kPeel},       // orange
      {41, false, Paint::kGlaze},      // cup
      {45, false, Paint::kGlaze},      // bowl
      {75, false, Paint::kGlaze},      // vase
      {64, false, Paint::kDarkMetal},  // mouse
      {77, false, Paint::kFur},        // teddy bear
      {-1, false, Paint::kCloth},      // any other
  };
  const PlainShape* shape = kShapes;
  while (shape->class_id != class_id && shape->class_id >= 0) ++shape;
  return *shape;
}

class Shapes {
 public:
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
    const PlainShape& plain = plain_shape_of(object.class_id);
    shapes_.push_back({plain.is_box, index, {}, plain.is_box ? box : axes, plain.paint});
  }

  std::vector<DrawnShape> take() { return std::move(shapes_); }

 private:
  void add_box(int object, const SE3& T_base_shape, const Vec3& half, Paint paint) {
    shapes_.push_back({true, object, T_base_shape, half, paint});
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
    shapes_.push_back({false, object, at(0.0, 0.0, axes.z() - leaves), {axes.x(), axes.y(), leaves}, Paint::kLeaves});
  }

  std::vector<DrawnShape> shapes_;
};

constexpr double kNear_m = 0.02;  ///< nearer corners count as behind the camera

const Box kEverywhere{-1e6, -1e6, 1e6, 1e6};

/// Around the corners; everywhere if the box reaches behind the camera; none if it is wholly behind.
std::optional<Box> box_bounds(const SE3& T_camera_shape, const Vec3& half) {
  Box bounds{1e6, 1e6, -1e6, -1e6};
  int behind = 0;
  for (int i = 0; i < 8; ++i) {
    const Vec3 corner((i & 1) != 0 ? half.x() : -half.x(), (i & 2) != 0 ? half.y() : -half.y(),
                      (i & 4) != 0 ? half.z() : -half.z());
    const Vec3 p = T_camera_shape * corner;
    if (p.z() < kNear_m) {
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
  return T_camera_shape.t.z() + half.maxCoeff() < kNear_m ? std::nullopt : std::optional<Box>(kEverywhere);
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
  return shapes.take();
}

std::optional<CastShape> cast_shape(const DrawnShape& shape, const SE3& T_camera_shape, int index) {
  const std::optional<Box> bounds =
      shape.is_box ? box_bounds(T_camera_shape, shape.half) : ellipsoid_bounds(T_camera_shape, shape.half);
  if (!bounds) return std::nullopt;
  const Vec3 inverse_half = shape.half.cwiseInverse();
  const SE3 T_shape_camera = T_camera_shape.inverse();
  return CastShape{(inverse_half.asDiagonal() * T_shape_camera.rotation()).cast<float>(),
                   inverse_half.cwiseProduct(T_shape_camera.t).cast<float>(),
                   T_camera_shape.rotation().cast<float>(),
                   inverse_half.cast<float>(),
                   shape.is_box,
                   index,
                   shape.object,
                   *bounds};
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
