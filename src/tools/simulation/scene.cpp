#include "tools/simulation/scene.h"

#include <algorithm>
#include <array>

#include "tools/simulation/random.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kTableHeight_m = 0.74;  ///< of office desks (EN 527)
constexpr int kMaxTries = 300;           ///< for a free place; without one an object is left out
constexpr double kDeskPitch_m = 2.2;     ///< office: between the middles of two desks
constexpr double kRoomLength_m = 5.0;    ///< house: the same

// COCO class ids of the objects that a desk may carry.
constexpr int kBottle = 39, kCup = 41, kBowl = 45, kApple = 47, kOrange = 49, kChair = 56, kPottedPlant = 58, kTv = 62,
              kLaptop = 63, kMouse = 64, kRemote = 65, kKeyboard = 66, kCellPhone = 67, kBook = 73, kClock = 74,
              kVase = 75, kTeddyBear = 77;

/// Range of semi-axes (x depth, y width, z height), m.
struct Shape {
  int class_id;
  Vec3 low, high;
  bool round;  ///< x = y, turned on a wheel
};

const Shape& shape_of(int class_id) {
  static const std::array<Shape, 17> kShapes{{
      {kBottle, {0.032, 0.032, 0.090}, {0.042, 0.042, 0.140}, true},
      {kCup, {0.040, 0.040, 0.045}, {0.052, 0.052, 0.065}, true},
      {kBowl, {0.070, 0.070, 0.032}, {0.090, 0.090, 0.048}, true},
      {kApple, {0.034, 0.034, 0.032}, {0.042, 0.042, 0.040}, true},
      {kOrange, {0.034, 0.034, 0.034}, {0.042, 0.042, 0.042}, true},
      {kChair, {0.240, 0.230, 0.400}, {0.290, 0.270, 0.470}, false},
      {kPottedPlant, {0.170, 0.170, 0.300}, {0.260, 0.260, 0.480}, true},
      {kTv, {0.065, 0.210, 0.180}, {0.085, 0.270, 0.235}, false},
      {kLaptop, {0.120, 0.160, 0.100}, {0.150, 0.190, 0.130}, false},
      {kMouse, {0.054, 0.032, 0.018}, {0.062, 0.037, 0.024}, false},
      {kRemote, {0.080, 0.022, 0.010}, {0.100, 0.028, 0.014}, false},
      {kKeyboard, {0.075, 0.200, 0.016}, {0.090, 0.240, 0.025}, false},
      {kCellPhone, {0.070, 0.036, 0.008}, {0.080, 0.042, 0.012}, false},
      {kBook, {0.085, 0.110, 0.012}, {0.115, 0.150, 0.035}, false},
      {kClock, {0.030, 0.060, 0.060}, {0.040, 0.080, 0.080}, false},
      {kVase, {0.048, 0.048, 0.075}, {0.068, 0.068, 0.140}, true},
      {kTeddyBear, {0.140, 0.140, 0.160}, {0.220, 0.200, 0.250}, false},
  }};
  return *std::find_if(kShapes.begin(), kShapes.end(), [class_id](const Shape& s) { return s.class_id == class_id; });
}

/// How many objects of a class a desk carries, and where: shares of the desk's half depth and half width.
struct Item {
  int class_id;
  int low, high;
  double x_low = -1.0, x_high = 1.0, y_low = -1.0, y_high = 1.0;
  double yaw_deg = 180.0;  ///< largest turn from facing the front
};

const std::vector<Item> kDeskItems = {{kTv, 1, 1, -0.7, -0.2, -0.5, 0.5, 20.0},
                                      {kKeyboard, 1, 1, 0.2, 0.8, -0.4, 0.4, 15.0},
                                      {kMouse, 1, 1, 0.2, 0.9, 0.3, 0.9, 30.0},
                                      {kLaptop, 0, 1, -0.8, 0.6, -0.9, 0.9, 180.0},
                                      {kBook, 4, 6},
                                      {kBottle, 2, 4},
                                      {kCup, 2, 3},
                                      {kBowl, 0, 1},
                                      {kVase, 0, 1},
                                      {kRemote, 0, 1},
                                      {kApple, 0, 1},
                                      {kCellPhone, 1, 1},
                                      {kClock, 0, 1},
                                      {kOrange, 0, 1}};

const std::vector<Item> kOfficeItems = {{kTv, 1, 1, -0.6, 0.0, -0.4, 0.4, 15.0},
                                        {kKeyboard, 1, 1, 0.3, 0.9, -0.3, 0.3, 15.0},
                                        {kMouse, 1, 1, 0.3, 0.9, 0.3, 0.7, 30.0},
                                        {kLaptop, 0, 1, -0.6, 0.6, -0.9, 0.9, 180.0},
                                        {kBook, 2, 4},
                                        {kBottle, 1, 3},
                                        {kCup, 1, 2},
                                        {kBowl, 0, 1},
                                        {kVase, 0, 1},
                                        {kRemote, 0, 1},
                                        {kCellPhone, 0, 1},
                                        {kClock, 0, 1},
                                        {kApple, 0, 1},
                                        {kOrange, 0, 1}};

Vec3 draw_semi_axes(int class_id, Random* random) {
  const Shape& shape = shape_of(class_id);
  Vec3 axes;
  for (int i = 0; i < 3; ++i) axes[i] = random->uniform(shape.low[i], shape.high[i]);
  if (shape.round) axes.y() = axes.x();
  return axes;
}

class Builder {
 public:
  Scene build(const SceneOptions& options, std::uint64_t seed) {
    Random room(seed);
    add_desks(options, &room);
    const bool office = options.layout == "office";
    for (std::size_t i = 0; i < scene_.desks.size(); ++i) {
      Random random(seed, options.identical_desks ? 1 : 1 + i);
      for (const Item& item : office ? kOfficeItems : kDeskItems) {
        const int count = random.integer(item.low, item.high);
        for (int k = 0; k < count; ++k) place_on_desk(scene_.desks[i], item, &random);
      }
    }
    for (const Desk& desk : scene_.desks) {
      place_on_floor(desk, kChair, true, &room);
      if (!office) place_on_floor(desk, kTeddyBear, false, &room);
      if (room.chance(office ? 0.5 : 1.0)) place_on_floor(desk, kPottedPlant, false, &room);
    }
    return std::move(scene_);
  }

 private:
  void add_desks(const SceneOptions& options, Random* random) {
    const bool office = options.layout == "office", house = options.layout == "house";
    const int count = options.desk_count();
    if (house) scene_.room_length_m = kRoomLength_m;
    const double room_yaw = random->uniform(-kPi, kPi);
    Vec3 room_origin(0.0, 0.0, kTableHeight_m);
    for (int i = 0; i < 2; ++i) room_origin[i] = random->uniform(-2.0, 2.0);
    const SE3 T_world_room = upright_pose(room_origin, room_yaw);
    for (int i = 0; i < count; ++i) {
      const double y = (i - 0.5 * (count - 1)) * (house ? kRoomLength_m : kDeskPitch_m);
      const double yaw = office ? random->uniform(-0.08, 0.08) : 0.0;
      const Desk desk{T_world_room * upright_pose({0.0, y, 0.0}, yaw), office ? 0.40 : 0.65, 0.80};
      scene_.desks.push_back(desk);
      taken_.push_back(footprint(desk.T_world_desk, desk.half_depth_m, desk.half_width_m));
    }
  }

  void place_on_desk(const Desk& desk, const Item& item, Random* random) {
    const Vec3 axes = draw_semi_axes(item.class_id, random);
    for (int i = 0; i < kMaxTries; ++i) {
      const double yaw = radians(random->uniform(-item.yaw_deg, item.yaw_deg));
      const double x = random->uniform(item.x_low, item.x_high) * desk.half_depth_m;
      const double y = random->uniform(item.y_low, item.y_high) * desk.half_width_m;
      const SE3 T_desk_object = upright_pose({x, y, axes.z()}, yaw);
      if (!stands_on(desk, T_desk_object, axes)) continue;
      const SE3 T_world_object = desk.T_world_desk * T_desk_object;
      if (add_if_free(item.class_id, T_world_object, axes, footprint(T_world_object, axes.x(), axes.y()))) {
        return;
      }
    }
  }

  void place_on_floor(const Desk& desk, int class_id, bool at_front, Random* random) {
    const Vec3 axes = draw_semi_axes(class_id, random);
    for (int i = 0; i < kMaxTries; ++i) {
      const double spread = at_front ? 0.4 : kPi;
      const double angle = random->uniform(-spread, spread);
      const double distance = random->uniform(0.0, 0.35) + std::max(desk.half_depth_m, desk.half_width_m * !at_front) +
                              axes.head<2>().maxCoeff();
      const Vec3 position(distance * std::cos(angle), distance * std::sin(angle), axes.z() - kTableHeight_m);
      const SE3 T_world_object = desk.T_world_desk * upright_pose(position, random->uniform(-kPi, kPi));
      const Footprint print = footprint(T_world_object, axes.x(), axes.y());
      const auto desks_end = taken_.begin() + static_cast<std::ptrdiff_t>(scene_.desks.size());
      const bool off_desks =
          std::all_of(taken_.begin(), desks_end, [&print](const Footprint& other) { return disjoint(print, other); });
      if (off_desks && add_if_free(class_id, T_world_object, axes, print)) return;
    }
  }

  bool add_if_free(int class_id, const SE3& T_world_object, const Vec3& axes, const Footprint& print) {
    for (std::size_t i = scene_.desks.size(); i < taken_.size(); ++i) {
      if (!disjoint(print, taken_[i])) return false;
    }
    scene_.objects.push_back({class_id, {T_world_object, axes}, {}});
    taken_.push_back(print);
    return true;
  }

  Scene scene_;
  std::vector<Footprint> taken_;  ///< of desks, then objects; a desk's own objects ignore the desks
};

constexpr int kGrid = 14;  ///< samples a side with which occlusion is measured

/// Where the lens model is trusted: the undistorted image with a margin. Farther out the polynomial may fold back.
Box undistorted_bounds(const Camera& camera) {
  constexpr int kSteps = 8;  // along each side of the image, whose undistorted outline is smooth
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

/// An ellipsoid as rays of one camera meet it: the unit sphere after p -> to_sphere * p + camera.
struct Caster {
  Mat3 to_sphere = Mat3::Identity();
  Vec3 camera = Vec3::Zero();
  bool below_table = false;
  std::optional<Box> pinhole, whole;  ///< undistorted and raw, not clipped; none: out of sight

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

/// Whether a table top lies between the camera and a point.
bool is_under_table(const std::vector<Desk>& desks, const Vec3& point_camera, const SE3& T_world_camera) {
  return std::any_of(desks.begin(), desks.end(), [&](const Desk& desk) {
    const SE3 T_desk_camera = desk.T_world_desk.inverse() * T_world_camera;
    const Vec3 eye = T_desk_camera.t, point = T_desk_camera * point_camera;
    if (!(eye.z() > 0.0 && point.z() < 0.0)) return false;
    const Vec3 crossing = eye + eye.z() / (eye.z() - point.z()) * (point - eye);
    return std::abs(crossing.x()) < desk.half_depth_m && std::abs(crossing.y()) < desk.half_width_m;
  });
}

ObjectView view_of(const Caster& object, const std::vector<Caster>& all, const std::vector<Desk>& desks,
                   const Camera& camera, const SE3& T_world_camera) {
  ObjectView view;
  view.whole = *object.whole;
  view.box = clip(view.whole, camera.width, camera.height);
  view.inside = std::min(1.0, view.box.area() / view.whole.area());
  view.visible = 1.0;
  std::vector<const Caster*> hiders;
  for (const Caster& other : all) {
    const bool overlaps = other.pinhole && intersection_area(*other.pinhole, *object.pinhole) > 0.0;
    if (&other != &object && overlaps) hiders.push_back(&other);
  }
  if (hiders.empty() && !object.below_table) return view;

  // The grid is laid in the undistorted image; its cells stand for the same cells of the raw box.
  const Box grid = camera.undistort(view.box);
  Cells covered, seen;
  for (int i = 0; i < kGrid * kGrid; ++i) {
    const int column = i % kGrid, row = i / kGrid;
    const Vec3 ray =
        camera.ray({grid.x1 + (column + 0.5) / kGrid * grid.width(), grid.y1 + (row + 0.5) / kGrid * grid.height()});
    const std::optional<double> range = object.hit(ray);
    if (!range) continue;
    covered.add(column, row);
    const bool is_hidden = std::any_of(hiders.begin(), hiders.end(), [&](const Caster* hider) {
      const std::optional<double> nearer = hider->hit(ray);
      return nearer && *nearer < *range;
    });
    if (is_hidden || (object.below_table && is_under_table(desks, ray * *range, T_world_camera))) continue;
    seen.add(column, row);
  }
  if (covered.count > 0) view.visible = static_cast<double>(seen.count) / covered.count;
  if (seen.count > 0) view.box = shrink(view.box, covered.extent, seen.extent);
  return view;
}

}  // namespace

std::optional<Ellipsoid> SceneObject::at(double time_s) const {
  if (phases.empty()) return ellipsoid;
  const auto next = std::upper_bound(phases.begin(), phases.end(), time_s,
                                     [](double time, const ObjectPhase& phase) { return time < phase.begin_s; });
  const ObjectPhase& phase = next == phases.begin() ? phases.front() : *(next - 1);
  if (!phase.is_present) return std::nullopt;
  Ellipsoid result = ellipsoid;
  result.T_world_quadric = phase.T_world_object;
  result.T_world_quadric.t += (time_s - phase.begin_s) * phase.velocity;
  return result;
}

int Scene::room_of(const Vec3& p_world) const {
  if (room_length_m == 0.0) return 0;
  const Vec3& first = desks.front().T_world_desk.t;
  const Vec3 row = (desks.back().T_world_desk.t - first).normalized();
  return static_cast<int>(std::lround((p_world - first).dot(row) / room_length_m));
}

Scene make_scene(const SceneOptions& options, std::uint64_t seed) { return Builder().build(options, seed); }

SceneProjector::SceneProjector(const Scene& scene, const Camera& camera)
    : scene_(&scene), camera_(camera), undistorted_image_(undistorted_bounds(camera)) {}

std::vector<std::optional<ObjectView>> SceneProjector::project(const SE3& T_world_camera, double time_s) const {
  const Mat34 P = projection_matrix(camera_, T_world_camera);
  const int room = scene_->room_of(T_world_camera.t);
  std::vector<Caster> casters;
  for (const SceneObject& object : scene_->objects) {
    casters.emplace_back();
    const std::optional<Ellipsoid> ellipsoid = object.at(time_s);
    if (!ellipsoid || scene_->room_of(ellipsoid->center()) != room) continue;
    const SE3 T_quadric_camera = ellipsoid->T_world_quadric.inverse() * T_world_camera;
    const Vec3 inverse_axes = ellipsoid->semi_axes.cwiseInverse();
    casters.back() = {inverse_axes.asDiagonal() * T_quadric_camera.rotation(),
                      inverse_axes.cwiseProduct(T_quadric_camera.t),
                      ellipsoid->center().z() < scene_->desks.front().T_world_desk.t.z(), project_box(*ellipsoid, P),
                      raw_box(*ellipsoid, T_world_camera)};
  }
  std::vector<std::optional<ObjectView>> views(casters.size());
  for (std::size_t i = 0; i < casters.size(); ++i) {
    const Caster& caster = casters[i];
    if (!caster.whole || !caster.pinhole || !clip(*caster.whole, camera_.width, camera_.height).is_valid()) continue;
    views[i] = view_of(caster, casters, scene_->desks, camera_, T_world_camera);
  }
  return views;
}

std::optional<Box> SceneProjector::raw_box(const Ellipsoid& ellipsoid, const SE3& T_world_camera) const {
  const std::optional<Conic> C = core::project(ellipsoid.dual(), projection_matrix(camera_, T_world_camera));
  const std::optional<Box> pinhole = C ? bounding_box(*C) : std::nullopt;
  if (!pinhole || !camera_.has_distortion()) return pinhole;
  // A line l touches the conic at C* l; the four points of contact are what the lens moves.
  const auto contact = [this, &C](const Vec3& line) -> Vec2 {
    const Vec2 pixel = (*C * line).hnormalized();
    return camera_.distort({std::clamp(pixel.x(), undistorted_image_.x1, undistorted_image_.x2),
                            std::clamp(pixel.y(), undistorted_image_.y1, undistorted_image_.y2)});
  };
  return Box{contact({1.0, 0.0, -pinhole->x1}).x(), contact({0.0, 1.0, -pinhole->y1}).y(),
             contact({1.0, 0.0, -pinhole->x2}).x(), contact({0.0, 1.0, -pinhole->y2}).y()};
}

}  // namespace semantic_topo_loop::core
