#include "tools/rendering/drawn_shape.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kTableThicknessM = 0.03;
constexpr double kLegM = 0.025;

SE3 at(double x, double y, double z) { return {Quaternion::Identity(), {x, y, z}}; }

class Shapes {
 public:
  void add_desk(const Desk& desk) {
    add_box(-1, desk.T_world_desk * at(0.0, 0.0, -0.5 * kTableThicknessM),
            {desk.half_depth_m, desk.half_width_m, 0.5 * kTableThicknessM}, Paint::kTableTop);
    const double leg_half = 0.5 * (desk.T_world_desk.t.z() - kTableThicknessM);
    for (const double x : {-1.0, 1.0}) {
      for (const double y : {-1.0, 1.0}) {
        add_box(-1,
                desk.T_world_desk *
                    at(x * (desk.half_depth_m - 0.05), y * (desk.half_width_m - 0.05), -kTableThicknessM - leg_half),
                {kLegM, kLegM, leg_half}, Paint::kDarkMetal);
      }
    }
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
      case 73:  // book
        return add_box(index, {}, box, Paint::kCover);
      case 66:  // keyboard
        return add_box(index, {}, box, Paint::kKeys);
      case 65:  // remote
      case 67:  // cell phone
        return add_box(index, {}, box, Paint::kDisplay);
      case 74:  // clock
        return add_box(index, {}, box, Paint::kDial);
      case 58:  // potted plant
        return add_plant(index, axes);
      case 39:  // bottle
        return add_ellipsoid(index, {}, axes, Paint::kLabel);
      case 47:  // apple
      case 49:  // orange
        return add_ellipsoid(index, {}, axes, Paint::kPeel);
      case 41:  // cup
      case 45:  // bowl
      case 75:  // vase
        return add_ellipsoid(index, {}, axes, Paint::kGlaze);
      case 64:  // mouse
        return add_ellipsoid(index, {}, axes, Paint::kDarkMetal);
      case 77:  // teddy bear
        return add_ellipsoid(index, {}, axes, Paint::kFur);
      default:
        return add_ellipsoid(index, {}, axes, Paint::kCloth);
    }
  }

  std::vector<DrawnShape> take() { return std::move(shapes_); }

 private:
  void add_box(int object, const SE3& T_base_shape, const Vec3& half, Paint paint) {
    shapes_.push_back({true, object, T_base_shape, half, paint});
  }
  void add_ellipsoid(int object, const SE3& T_base_shape, const Vec3& half, Paint paint) {
    shapes_.push_back({false, object, T_base_shape, half, paint});
  }

  /// Seat, back at -x, legs.
  void add_chair(int object, const Vec3& box) {
    constexpr double kPlateM = 0.03;
    const double seat = -0.05 * box.z();
    add_box(object, at(0.0, 0.0, seat), {box.x(), box.y(), kPlateM}, Paint::kCloth);
    const double back_half = 0.5 * (box.z() - seat);
    add_box(object, at(kPlateM - box.x(), 0.0, seat + back_half), {kPlateM, box.y(), back_half}, Paint::kCloth);
    const double leg_half = 0.5 * (seat + box.z());
    for (const double x : {-1.0, 1.0}) {
      for (const double y : {-1.0, 1.0}) {
        add_box(object, at(x * (box.x() - kLegM), y * (box.y() - kLegM), leg_half - box.z()), {kLegM, kLegM, leg_half},
                Paint::kDarkMetal);
      }
    }
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
    constexpr double kPlateM = 0.010;
    add_box(object, at(0.0, 0.0, kPlateM - box.z()), {box.x(), box.y(), kPlateM}, Paint::kKeys);
    add_box(object, at(kPlateM - box.x(), 0.0, 0.0), {kPlateM, box.y(), box.z()}, Paint::kScreen);
  }

  /// Leaves over a pot, both within the ellipsoid's height.
  void add_plant(int object, const Vec3& axes) {
    const double pot = 0.25 * axes.z();
    const double leaves = axes.z() - pot;
    add_box(object, at(0.0, 0.0, pot - axes.z()), {0.5 * axes.x(), 0.5 * axes.y(), pot}, Paint::kGlaze);
    add_ellipsoid(object, at(0.0, 0.0, axes.z() - leaves), {axes.x(), axes.y(), leaves}, Paint::kLeaves);
  }

  std::vector<DrawnShape> shapes_;
};

}  // namespace

std::vector<DrawnShape> drawn_shapes(const Scene& scene) {
  Shapes shapes;
  for (const Desk& desk : scene.desks) shapes.add_desk(desk);
  for (std::size_t i = 0; i < scene.objects.size(); ++i) shapes.add_object(static_cast<int>(i), scene.objects[i]);
  return shapes.take();
}

}  // namespace semantic_topo_loop::core
