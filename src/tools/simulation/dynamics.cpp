#include "tools/simulation/dynamics.h"

#include <algorithm>

#include "tools/simulation/random.h"
#include "tools/simulation/scene.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kPerson = 0;
constexpr double kWalkSpeed_m_s = 1.2;  ///< m/s
constexpr double kWalk_s = 6.0;         ///< long enough to begin and end outside the view
constexpr double kNearShare = 0.55;     ///< of the way from what the camera looks at to the camera
constexpr double kFar_m = 1.2;          ///< behind what the camera looks at
constexpr double kWalkTilt_deg = 20.0;  ///< largest angle between a walk and the image plane
constexpr double kMinMove_m = 0.5;
constexpr int kMaxTries = 300;

/// COCO ids of what people carry about, in the order in which it is moved: cup, bottle, bowl, vase, apple, orange,
/// clock, remote, cell phone, book.
constexpr int kCarried[] = {41, 39, 45, 75, 47, 49, 74, 65, 67, 73};

Vec3 horizontal(const Vec3& v) { return {v.x(), v.y(), 0.0}; }

/// Where the camera's axis meets the height of the table tops; a point far ahead if it does not look down.
Vec3 looked_at(const SE3& T_world_camera, double table_height_m) {
  constexpr double kFarAhead_m = 3.0;
  const Vec3 forward = T_world_camera.rotation().col(2);
  const double drop = T_world_camera.t.z() - table_height_m;
  const double range = forward.z() < 0.0 && drop > 0.0 ? drop / -forward.z() : kFarAhead_m;
  return T_world_camera.t + std::min(range, kFarAhead_m) * forward;
}

/// A person whose walk is half over at a time.
SceneObject make_person(const SE3& T_world_camera, double table_height_m, double middle_s, bool is_near,
                        Random* random) {
  const Vec3 target = looked_at(T_world_camera, table_height_m);
  const Vec3 to_camera = horizontal(T_world_camera.t - target);
  const Vec3 outward = to_camera.normalized();
  const Vec3 semi_axes(random->uniform(0.14, 0.18), random->uniform(0.22, 0.27), random->uniform(0.80, 0.92));
  Vec3 crossing = horizontal(target) + (is_near ? kNearShare * to_camera.norm() : -kFar_m) * outward;
  crossing.z() = semi_axes.z();
  const double side = random->chance(0.5) ? 90.0 : -90.0;
  const double yaw =
      std::atan2(outward.y(), outward.x()) + radians(side + random->uniform(-kWalkTilt_deg, kWalkTilt_deg));

  SceneObject person;
  person.class_id = kPerson;
  person.ellipsoid.semi_axes = semi_axes;
  ObjectPhase absent, walk;
  absent.is_present = false;
  walk.begin_s = middle_s - 0.5 * kWalk_s;
  walk.velocity = kWalkSpeed_m_s * Vec3(std::cos(yaw), std::sin(yaw), 0.0);
  walk.T_world_object = upright_pose(crossing - 0.5 * kWalk_s * walk.velocity, yaw);
  person.ellipsoid.T_world_quadric = upright_pose(crossing + 0.5 * kWalk_s * walk.velocity, yaw);
  absent.begin_s = std::min(0.0, walk.begin_s - kWalk_s);
  person.phases = {absent, walk, absent};
  person.phases.back().begin_s = walk.begin_s + kWalk_s;
  return person;
}

/// The desk that an object stands on; none for the floor.
const Desk* desk_of(const Scene& scene, const SceneObject& object) {
  const auto it = std::find_if(scene.desks.begin(), scene.desks.end(), [&object](const Desk& desk) {
    const Vec3 p = desk.T_world_desk.inverse() * object.ellipsoid.center();
    return p.z() > 0.0 && std::abs(p.x()) < desk.half_depth_m && std::abs(p.y()) < desk.half_width_m;
  });
  return it == scene.desks.end() ? nullptr : &*it;
}

/// A free place on the desk, or on any other one if there are several.
std::optional<SE3> free_place(const Scene& scene, const SceneObject& object, const Desk& from,
                              const std::vector<Footprint>& taken, Random* random) {
  const Vec3& axes = object.ellipsoid.semi_axes;
  for (int i = 0; i < kMaxTries; ++i) {
    const Desk& desk = scene.desks[static_cast<std::size_t>(random->index(static_cast<int>(scene.desks.size())))];
    const double x = random->uniform(-1.0, 1.0) * desk.half_depth_m, y = random->uniform(-1.0, 1.0) * desk.half_width_m;
    const SE3 T_desk_object = upright_pose({x, y, axes.z()}, random->uniform(-kPi, kPi));
    const SE3 T_world_object = desk.T_world_desk * T_desk_object;
    const bool is_same = &desk == &from;
    if (is_same && (scene.desks.size() > 1 || (T_world_object.t - object.ellipsoid.center()).norm() < kMinMove_m)) {
      continue;
    }
    const Footprint print = footprint(T_world_object, axes.x(), axes.y());
    const bool is_free =
        std::all_of(taken.begin(), taken.end(), [&print](const Footprint& other) { return disjoint(print, other); });
    if (is_free && stands_on(desk, T_desk_object, axes)) return T_world_object;
  }
  return std::nullopt;
}

void move_objects(const DynamicsOptions& options, Random* random, Scene* scene) {
  std::vector<Footprint> taken;
  for (const SceneObject& object : scene->objects) taken.push_back(footprint(object.ellipsoid));
  int moved = 0;
  for (const int class_id : kCarried) {
    for (SceneObject& object : scene->objects) {
      const Desk* desk =
          object.class_id == class_id && moved < options.moved_objects ? desk_of(*scene, object) : nullptr;
      const std::optional<SE3> place =
          desk != nullptr ? free_place(*scene, object, *desk, taken, random) : std::nullopt;
      if (!place) continue;
      ObjectPhase before, after;
      before.T_world_object = object.ellipsoid.T_world_quadric;
      after.T_world_object = object.ellipsoid.T_world_quadric = *place;
      after.begin_s = options.move_time_s;
      object.phases = {before, after};
      taken.push_back(footprint(object.ellipsoid));
      ++moved;
    }
  }
}

}  // namespace

void add_dynamics(const DynamicsOptions& options, const CameraTrajectory& trajectory, double duration_s,
                  std::uint64_t seed, Scene* scene) {
  Random movers(seed, 0), people(seed, 1);
  move_objects(options, &movers, scene);
  const double table_height_m = scene->desks.front().T_world_desk.t.z();
  for (int i = 0; i < options.persons; ++i) {
    const double middle_s = duration_s * (i + 0.5) / options.persons;
    scene->objects.push_back(
        make_person(trajectory.T_world_camera(middle_s), table_height_m, middle_s, i % 2 == 0, &people));
  }
}

}  // namespace semantic_topo_loop::core
