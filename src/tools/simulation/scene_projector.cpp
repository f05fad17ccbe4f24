#include "tools/simulation/scene_projector.h"

#include <algorithm>

#include "semantic_topo_loop/geometry/quadric.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kGrid = 14;  ///< samples a side with which occlusion is measured

/// Where the lens model is trusted: the undistorted image with a margin. Farther out the polynomial may fold back.
Box undistorted_bounds(const Camera& camera) {
  constexpr int kSteps = 8;
  const double w = camera.width, h = camera.height;
  Box bounds{0.0, 0.0, w, h};
  for (int i = 0; i <= kSteps; ++i) {
    const double x = w * i / kSteps, y = h * i / kSteps;
    for (const Vec2& border : {Vec2(x, 0.0), Vec2(x, h), Vec2(0.0, y), Vec2(w, y)}) {
      const Vec2 p = camera.undistort(border);
      bounds = {std::min(bounds.x1, p.x()), std::min(bounds.y1, p.y()), std::max(bounds.x2, p.x()),
                std::max(bounds.y2, p.y())};
    }
  }
  return {bounds.x1 - 0.1 * w, bounds.y1 - 0.1 * h, bounds.x2 + 0.1 * w, bounds.y2 + 0.1 * h};
}

/// Pulls in the sides whose outermost cells are hidden.
/// @param covered cells that the object covers   @param seen those of them that nothing hides
Box shrink(const Box& box, const Box& covered, const Box& seen) {
  const double cell_x = box.width() / kGrid, cell_y = box.height() / kGrid;
  Box result = box;
  if (seen.x1 > covered.x1) result.x1 = box.x1 + seen.x1 * cell_x;
  if (seen.y1 > covered.y1) result.y1 = box.y1 + seen.y1 * cell_y;
  if (seen.x2 < covered.x2) result.x2 = box.x1 + seen.x2 * cell_x;
  if (seen.y2 < covered.y2) result.y2 = box.y1 + seen.y2 * cell_y;
  return result;
}

/// Rectangle of grid cells, and how many.
struct Cells {
  Box extent{kGrid, kGrid, 0.0, 0.0};
  int count = 0;

  void add(int column, int row) {
    ++count;
    extent = {std::min(extent.x1, column + 0.0), std::min(extent.y1, row + 0.0), std::max(extent.x2, column + 1.0),
              std::max(extent.y2, row + 1.0)};
  }
};

}  // namespace

/// An ellipsoid as rays of one camera meet it: the unit sphere after p -> to_sphere * p + camera.
struct SceneProjector::Caster {
  Mat3 to_sphere = Mat3::Identity();
  Vec3 camera = Vec3::Zero();
  bool below_table = false;
  std::optional<Box> pinhole;  ///< none: out of sight

  /// Distance along the ray (in lengths of `ray`) to the first hit; none if missed or behind.
  std::optional<double> hit(const Vec3& ray) const {
    const Vec3 d = to_sphere * ray;
    const double a = d.squaredNorm(), b = d.dot(camera), c = camera.squaredNorm() - 1.0;
    const double discriminant = b * b - a * c;
    if (discriminant <= 0.0) return std::nullopt;
    const double range = (-b - std::sqrt(discriminant)) / a;
    return range > 0.0 ? std::optional<double>(range) : std::nullopt;
  }
};

SceneProjector::SceneProjector(const Scene& scene, const Camera& camera)
    : scene_(&scene), camera_(camera), undistorted_image_(undistorted_bounds(camera)) {}

std::vector<std::optional<ObjectView>> SceneProjector::project(const SE3& T_world_camera, double time_s) const {
  const Mat34 P = projection_matrix(camera_, T_world_camera);
  std::vector<Caster> casters;
  std::vector<std::optional<Box>> wholes;
  for (const SceneObject& object : scene_->objects) {
    casters.emplace_back();
    wholes.emplace_back();
    const std::optional<Ellipsoid> ellipsoid = object.at(time_s);
    if (!ellipsoid) continue;
    const SE3 T_quadric_camera = ellipsoid->T_world_quadric.inverse() * T_world_camera;
    const Vec3 inverse_axes = ellipsoid->semi_axes.cwiseInverse();
    casters.back() = {inverse_axes.asDiagonal() * T_quadric_camera.rotation(),
                      inverse_axes.cwiseProduct(T_quadric_camera.t), is_below_table(*ellipsoid),
                      project_box(*ellipsoid, P)};
    wholes.back() = raw_box(*ellipsoid, T_world_camera);
  }
  std::vector<std::optional<ObjectView>> views(casters.size());
  for (std::size_t i = 0; i < casters.size(); ++i) {
    if (!wholes[i] || !casters[i].pinhole || !clip(*wholes[i], camera_.width, camera_.height).is_valid()) continue;
    views[i] = view(*wholes[i], i, casters, T_world_camera);
  }
  return views;
}

std::optional<Box> SceneProjector::raw_box(const Ellipsoid& ellipsoid, const SE3& T_world_camera) const {
  const std::optional<Conic> C = core::project(ellipsoid.dual(), projection_matrix(camera_, T_world_camera));
  const std::optional<Box> pinhole = C ? bounding_box(*C) : std::nullopt;
  if (!pinhole || !camera_.has_distortion()) return pinhole;
  // A line l touches the conic at C* l; the four points of contact are what the lens moves.
  const auto contact = [this, &C](const Vec3& line) { return distort((*C * line).hnormalized()); };
  return Box{contact({1.0, 0.0, -pinhole->x1}).x(), contact({0.0, 1.0, -pinhole->y1}).y(),
             contact({1.0, 0.0, -pinhole->x2}).x(), contact({0.0, 1.0, -pinhole->y2}).y()};
}

ObjectView SceneProjector::view(const Box& whole, std::size_t object, const std::vector<Caster>& casters,
                                const SE3& T_world_camera) const {
  ObjectView view;
  view.whole = whole;
  view.box = clip(whole, camera_.width, camera_.height);
  view.inside = std::min(1.0, view.box.area() / whole.area());
  view.visible = 1.0;
  const std::vector<const Caster*> hiders = possible_hiders(object, casters);
  const bool below_table = casters[object].below_table;
  if (hiders.empty() && !below_table) return view;

  // The grid is laid in the undistorted image; its cells stand for the same cells of the raw box.
  const Box grid = camera_.undistort(view.box);
  Cells covered, seen;
  for (int i = 0; i < kGrid * kGrid; ++i) {
    const int column = i % kGrid, row = i / kGrid;
    const Vec3 ray =
        camera_.ray({grid.x1 + (column + 0.5) / kGrid * grid.width(), grid.y1 + (row + 0.5) / kGrid * grid.height()});
    const std::optional<double> range = casters[object].hit(ray);
    if (!range) continue;
    covered.add(column, row);
    if (is_hidden(ray, *range, hiders) || (below_table && is_under_table(ray * *range, T_world_camera))) continue;
    seen.add(column, row);
  }
  if (covered.count > 0) view.visible = static_cast<double>(seen.count) / covered.count;
  if (seen.count > 0) view.box = shrink(view.box, covered.extent, seen.extent);
  return view;
}

std::vector<const SceneProjector::Caster*> SceneProjector::possible_hiders(std::size_t object,
                                                                           const std::vector<Caster>& casters) {
  std::vector<const Caster*> hiders;
  for (std::size_t i = 0; i < casters.size(); ++i) {
    if (i != object && casters[i].pinhole && intersection_area(*casters[i].pinhole, *casters[object].pinhole) > 0.0) {
      hiders.push_back(&casters[i]);
    }
  }
  return hiders;
}

bool SceneProjector::is_hidden(const Vec3& ray, double range, const std::vector<const Caster*>& hiders) {
  return std::any_of(hiders.begin(), hiders.end(), [&](const Caster* hider) {
    const std::optional<double> nearer = hider->hit(ray);
    return nearer && *nearer < range;
  });
}

bool SceneProjector::is_below_table(const Ellipsoid& ellipsoid) const {
  return ellipsoid.center().z() < scene_->desks.front().T_world_desk.t.z();
}

bool SceneProjector::is_under_table(const Vec3& point_camera, const SE3& T_world_camera) const {
  return std::any_of(scene_->desks.begin(), scene_->desks.end(), [&](const Desk& desk) {
    const SE3 T_desk_camera = desk.T_world_desk.inverse() * T_world_camera;
    const Vec3 eye = T_desk_camera.t, point = T_desk_camera * point_camera;
    if (!(eye.z() > 0.0 && point.z() < 0.0)) return false;
    const Vec3 crossing = eye + eye.z() / (eye.z() - point.z()) * (point - eye);
    return std::abs(crossing.x()) < desk.half_depth_m && std::abs(crossing.y()) < desk.half_width_m;
  });
}

Vec2 SceneProjector::distort(const Vec2& pixel) const {
  return camera_.distort({std::clamp(pixel.x(), undistorted_image_.x1, undistorted_image_.x2),
                          std::clamp(pixel.y(), undistorted_image_.y1, undistorted_image_.y2)});
}

}  // namespace semantic_topo_loop::core
