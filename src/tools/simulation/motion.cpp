#include "tools/simulation/motion.h"

#include <algorithm>
#include <array>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

// The robot.
constexpr double kStopPeriod_s = 11.0;  ///< three or four stops a lap
constexpr double kScan_deg = 35.0;      ///< of the look around at a stop: 20 deg to either side, as it dies away
constexpr double kMount_deg = 55.0;     ///< of the camera, from the way it drives towards the desks
constexpr double kTilt_deg = 18.0;      ///< of the camera, downwards

/// Rotation of a level camera's optical frame.
Mat3 looking(const Vec3& direction) {
  const Vec3 forward = direction.normalized();
  const Vec3 right = forward.cross(Vec3::UnitZ()).normalized();
  Mat3 R_world_camera;
  R_world_camera << right, forward.cross(right), forward;
  return R_world_camera;
}

constexpr int kPerson = 0;              ///< COCO
constexpr double kWalkSpeed_m_s = 1.2;  ///< an unhurried walk
constexpr double kWalk_s = 6.0;         ///< long enough to begin and end outside the view
constexpr double kNearShare = 0.55;     ///< of the way from what the camera looks at to the camera
constexpr double kFar_m = 1.2;          ///< behind what the camera looks at
constexpr double kWalkTilt_deg = 20.0;  ///< largest angle between a walk and the image plane
constexpr double kMinMove_m = 0.5;      ///< on the same desk: several times the size of what is moved
constexpr int kMaxTries = 300;          ///< for a free place; without one an object stays

/// COCO ids of what people carry about, in the order in which it is moved: cup, bottle, bowl, vase, apple, orange,
/// clock, remote, cell phone, book.
constexpr int kCarried[] = {41, 39, 45, 75, 47, 49, 74, 65, 67, 73};
/// What is taken away, chairs first, and what is brought, bottles first.
constexpr int kRemoved[] = {56, 41, 45, 75}, kBrought[] = {39, 45, 41, 75};

Vec3 horizontal(const Vec3& v) { return {v.x(), v.y(), 0.0}; }

/// Where the camera's axis meets the height of the table tops; a point far ahead if it does not look down.
Vec3 looked_at(const SE3& T_world_camera, double table_height_m) {
  constexpr double kFarAhead_m = 3.0;  // about the far side of a desk
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

/// Has objects come or go: the first that stay, of these classes in their order.
template <class Classes>
void appear_or_vanish(const Classes& classes, int count, bool appears, double time_s, Scene* scene) {
  for (const int class_id : classes) {
    for (SceneObject& object : scene->objects) {
      if (count == 0) return;
      if (object.class_id != class_id || !object.phases.empty()) continue;
      ObjectPhase before, after;
      before.T_world_object = after.T_world_object = object.ellipsoid.T_world_quadric;
      before.is_present = !appears;
      after.is_present = appears;
      after.begin_s = time_s;
      object.phases = {before, after};
      --count;
    }
  }
}

/// A smooth random function of time with zero mean and unit standard deviation: a sum of sinusoids.
class SmoothNoise {
 public:
  SmoothNoise() = default;
  SmoothNoise(double low_hz, double high_hz, Random* random) {
    for (Wave& wave : waves_) {
      wave.hz = random->uniform(low_hz, high_hz);
      wave.phase = random->uniform(0.0, 2.0 * kPi);
    }
  }
  double operator()(double time_s) const {
    double sum = 0.0;
    for (const Wave& wave : waves_) sum += std::sin(2.0 * kPi * wave.hz * time_s + wave.phase);
    return sum * std::sqrt(2.0 / static_cast<double>(waves_.size()));
  }

 private:
  struct Wave {
    double hz = 0.0, phase = 0.0;
  };
  std::array<Wave, 4> waves_;
};

/// The lap that trajectories follow: an oval around the middle line of the desks that are visited, without corners in
/// the pace.
class Lap {
 public:
  Lap(const Scene& scene, const TrajectoryOptions& options) : distance_m_(options.distance_m) {
    const auto first = static_cast<std::size_t>(options.first_desk) - 1;
    const std::size_t count = options.desks > 0 ? static_cast<std::size_t>(options.desks) : scene.desks.size() - first;
    line_start_ = scene.desks[first].T_world_desk.t;
    const Vec3 line = scene.desks[first + count - 1].T_world_desk.t - line_start_;
    line_length_m_ = line.norm();
    // A single desk is circled; any direction serves as its middle line.
    line_direction_ = line_length_m_ > 1e-6 ? Vec3(line / line_length_m_) : Vec3::UnitX();
  }

  /// A place of the lap, at table height.
  struct Place {
    Vec3 line_point;  ///< the nearest point of the middle line
    Vec3 outward;     ///< unit
  };
  /// @param laps whole laps repeat
  Place at(double laps) const {
    // A moving average rounds the corners of the pace, where straight meets arc.
    constexpr int kSamples = 16;  // so that a step of the average is below a hundredth of a lap
    Station mean;
    for (int i = 0; i < kSamples; ++i) {
      const Station s = station(laps + window_laps() * ((i + 0.5) / kSamples - 0.5));
      mean.along_m += s.along_m / kSamples;
      mean.angle += s.angle / kSamples;
    }
    const Vec3 side(line_direction_.y(), -line_direction_.x(), 0.0);
    return {line_start_ + mean.along_m * line_direction_,
            std::cos(mean.angle) * side + std::sin(mean.angle) * line_direction_};
  }
  /// Over which its corners are rounded: a tenth of it, but not more than the way around the end of a long row.
  double window_laps() const { return std::min(0.1, kMaxWindow_m / (2.0 * (line_length_m_ + kPi * distance_m_))); }

 private:
  static constexpr double kMaxWindow_m = 4.0;

  /// How far along the desks' middle line, and on which side of it.
  struct Station {
    double along_m = 0.0, angle = 0.0;
  };

  Station station(double laps) const {
    const double whole = std::floor(laps);
    const double arc = kPi * distance_m_;
    const double way = (laps - whole) * 2.0 * (line_length_m_ + arc);
    const double turns = 2.0 * kPi * whole;
    if (way < line_length_m_) return {way, turns};
    if (way < line_length_m_ + arc) return {line_length_m_, turns + (way - line_length_m_) / distance_m_};
    if (way < 2.0 * line_length_m_ + arc) return {2.0 * line_length_m_ + arc - way, turns + kPi};
    return {0.0, turns + kPi + (way - 2.0 * line_length_m_ - arc) / distance_m_};
  }

  double distance_m_;
  Vec3 line_start_ = Vec3::Zero();
  Vec3 line_direction_ = Vec3::UnitX();
  double line_length_m_ = 0.0;
};

/// Where on the lap a camera begins, and which way round it goes.
struct LapStart {
  explicit LapStart(Random* random) : lap(random->uniform()), sense(random->chance(0.5) ? 1.0 : -1.0) {}
  double lap, sense;
};

CameraTrajectory handheld(const TrajectoryOptions& options, const Lap& lap, Random random) {
  const LapStart start(&random);
  std::array<SmoothNoise, 5> wander_noise;
  std::array<SmoothNoise, 6> shake_noise;
  for (SmoothNoise& noise : wander_noise) noise = SmoothNoise(0.03, 0.15, &random);
  for (SmoothNoise& noise : shake_noise) noise = SmoothNoise(0.8, 5.0, &random);
  const auto laps = [=](double time_s) {
    const double steady = time_s / options.lap_s;
    if (options.arc_deg == 360.0) return start.lap + start.sense * steady;
    return start.lap + start.sense * 0.5 * options.arc_deg / 360.0 * std::sin(2.0 * kPi * steady);
  };
  return [=](double time_s) {
    const auto [line_point, outward] = lap.at(laps(time_s));

    std::array<double, 5> wander;
    for (std::size_t i = 0; i < wander.size(); ++i) wander[i] = options.wander_m * wander_noise[i](time_s);
    Vec3 position = line_point + (options.distance_m + wander[0]) * outward;
    position.z() = options.height_m + wander[1];
    const Vec3 target = line_point + Vec3(wander[2], wander[3], 0.5 * wander[4]);

    Vec6 shake;
    for (int i = 0; i < 6; ++i) {
      const double amplitude = i < 3 ? options.shake_m : radians(options.shake_deg);
      shake[i] = amplitude * shake_noise[static_cast<std::size_t>(i)](time_s);
    }
    return SE3(looking(target - position), position) * se3_exp(shake);
  };
}

CameraTrajectory robot(const TrajectoryOptions& options, const Lap& lap, Random random) {
  const LapStart start(&random);
  const double first_stop = random.uniform(0.0, 2.0 * kPi);  // phase, rad
  const SmoothNoise wander(0.02, 0.08, &random);
  const auto position = [=](double laps) {
    const auto [line_point, outward] = lap.at(laps);
    Vec3 place = line_point + (options.distance_m + options.wander_m * wander(laps * options.lap_s)) * outward;
    place.z() = options.height_m;
    return place;
  };
  return [=](double now_s) {
    constexpr double kParkingPeriod_s = 1800.0;
    const double periods = std::floor(now_s / kParkingPeriod_s),
                 driving_s = (1.0 - options.parked_share) * kParkingPeriod_s;
    const double time_s = options.parked_share > 0.0
                              ? periods * driving_s + std::min(now_s - periods * kParkingPeriod_s, driving_s)
                              : now_s;
    // Speed 1 - cos(phase) of the mean: it stands where the phase is a whole turn, and turns on the spot around then.
    const double phase = 2.0 * kPi * time_s / kStopPeriod_s + first_stop;
    const double way_s = time_s - kStopPeriod_s / (2.0 * kPi) * (std::sin(phase) - std::sin(first_stop));
    const double laps = start.lap + start.sense * way_s / options.lap_s;
    const double standing = std::max(0.0, std::cos(phase));
    const double scan = radians(kScan_deg) * standing * standing * standing * std::sin(2.0 * phase);

    // Over a fifth of the window that smoothes the lap, so that the heading turns as smoothly as the place moves.
    const double step = lap.window_laps() / 10.0;
    const Vec3 heading = start.sense * (position(laps + step) - position(laps - step));
    const double inward = start.sense * radians(kMount_deg);
    const Vec3 level = Quaternion(Eigen::AngleAxisd(inward + scan, Vec3::UnitZ())) * heading.normalized();
    const double tilt = radians(kTilt_deg);
    return SE3(looking(std::cos(tilt) * level - std::sin(tilt) * Vec3::UnitZ()), position(laps));
  };
}

}  // namespace

CameraTrajectory make_trajectory(const Scene& scene, const TrajectoryOptions& options, std::uint64_t seed) {
  const Lap lap(scene, options);
  return options.model == "robot" ? robot(options, lap, Random(seed)) : handheld(options, lap, Random(seed));
}

void add_dynamics(const DynamicsOptions& options, const CameraTrajectory& trajectory, double duration_s,
                  std::uint64_t seed, Scene* scene) {
  Random movers(seed, 0), people(seed, 1);
  move_objects(options, &movers, scene);
  appear_or_vanish(kRemoved, options.removed_objects, false, options.move_time_s, scene);
  appear_or_vanish(kBrought, options.new_objects, true, options.move_time_s, scene);
  const double table_height_m = scene->desks.front().T_world_desk.t.z();
  for (int i = 0; i < options.persons; ++i) {
    const double middle_s = duration_s * (i + 0.5) / options.persons;
    scene->objects.push_back(make_person(trajectory(middle_s), table_height_m, middle_s, i % 2 == 0, &people));
  }
}

}  // namespace semantic_topo_loop::core
