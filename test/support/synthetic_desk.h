#pragma once

#include <cmath>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "loop/submap/spheroid.h"
#include "loop/submap/submap_builder.h"
#include "semantic_topo_loop/loop/loop_detector.h"
#include "semantic_topo_loop/loop/loop_options.h"
#include "semantic_topo_loop/pipeline/frame_builder.h"
#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"
#include "support/look_at.h"

namespace semantic_topo_loop::core::testing {

/// Uniform in [low, high), the same on every platform.
inline double uniform(std::mt19937_64& random, double low, double high) {
  return low + (high - low) * static_cast<double>(random() >> 11) * 0x1.0p-53;
}

/// Roughly normal with unit variance.
inline double noise(std::mt19937_64& random) {
  double sum = -6.0;
  for (int i = 0; i < 12; ++i) sum += uniform(random, 0.0, 1.0);
  return sum;
}

inline std::shared_ptr<const ClassTable> desk_classes() {
  std::vector<ObjectClass> classes;
  for (int id = 0; id < 8; ++id) {
    ObjectClass object_class;
    object_class.id = id;
    object_class.name = "class_" + std::to_string(id);
    object_class.role = id == 7 ? ClassRole::kDynamic : ClassRole::kMovable;
    classes.push_back(object_class);
  }
  return std::make_shared<const ClassTable>(*ClassTable::create(classes));
}

struct DeskObject {
  int class_id;
  Spheroid spheroid;  ///< about world z
};

/// A desk with its top at z = 0.7 m and `count` objects of six classes on it.
inline std::vector<DeskObject> random_desk(std::uint64_t seed, int count, const Vec3& middle = Vec3(0.0, 0.0, 0.7)) {
  std::mt19937_64 random(seed);
  std::vector<DeskObject> objects;
  while (static_cast<int>(objects.size()) < count) {
    DeskObject object;
    object.class_id = static_cast<int>(objects.size()) % 6;
    const double across = uniform(random, 0.04, 0.10), along = uniform(random, 0.04, 0.14);
    object.spheroid.center = middle + Vec3(uniform(random, -0.8, 0.8), uniform(random, -0.5, 0.5), along);
    object.spheroid.log_axes = Vec2(std::log(across), std::log(along));
    bool apart = true;
    for (const DeskObject& other : objects) {
      apart = apart && (other.spheroid.center - object.spheroid.center).norm() > 0.18;
    }
    if (apart) objects.push_back(object);
  }
  return objects;
}

inline Camera desk_camera() { return {520.0, 520.0, 320.0, 240.0, 640, 480, {}}; }

struct Visit {
  double begin_s, end_s;
  double begin_deg, end_deg;  ///< position on a circle around the desk
};

/// Camera at a time: on the circle during visits, far away and looking elsewhere between them.
inline SE3 desk_pose(const std::vector<Visit>& visits, double time_s, const Vec3& middle = Vec3(0.0, 0.0, 0.7)) {
  for (const Visit& visit : visits) {
    if (time_s < visit.begin_s || time_s > visit.end_s) continue;
    const double ratio = (time_s - visit.begin_s) / (visit.end_s - visit.begin_s);
    const double angle = radians(visit.begin_deg + ratio * (visit.end_deg - visit.begin_deg));
    const double height = 0.8 + 0.15 * std::sin(1.3 * time_s);
    return testing::look_at(middle + Vec3(1.7 * std::cos(angle), 1.7 * std::sin(angle), height), middle);
  }
  return testing::look_at(middle + Vec3(-3.0, -3.0, 0.9), middle + Vec3(-8.0, -6.0 + 0.05 * time_s, 0.5));
}

/// The boxes of the desk's objects with 2 px of noise. Ids are `first_id` + index, as an association would give them.
inline AssociationFrame observe(const std::vector<DeskObject>& desk, const Frame& frame, const SE3& T_world_camera,
                                std::int64_t first_id, std::mt19937_64& random) {
  AssociationFrame result;
  result.frame_id = frame.frame_id;
  const Camera& camera = frame.camera;
  const SE3 T_camera_world = T_world_camera.inverse();
  for (std::size_t i = 0; i < desk.size(); ++i) {
    const auto box = spheroid_box(T_camera_world * desk[i].spheroid.center, T_camera_world.q * Vec3::UnitZ(),
                                  desk[i].spheroid.log_axes);
    if (!box) continue;
    Box pixels{camera.fx * box->x1 + camera.cx, camera.fy * box->y1 + camera.cy, camera.fx * box->x2 + camera.cx,
               camera.fy * box->y2 + camera.cy};
    for (double* edge : {&pixels.x1, &pixels.y1, &pixels.x2, &pixels.y2}) *edge += 2.0 * noise(random);
    pixels = clip(pixels, camera.width, camera.height);
    if (!pixels.is_valid() || pixels.size() < 8.0) continue;
    Association association;
    association.detection_index = static_cast<std::int32_t>(result.associations.size());
    association.landmark_id = first_id + static_cast<std::int64_t>(i);
    association.level = AssociationLevel::kJoint;
    association.class_id = association.landmark_class_id = desk[i].class_id;
    association.score = 0.9;
    association.box = pixels;
    association.truncated = truncated_sides(pixels, camera.width, camera.height, 4.0);
    result.associations.push_back(association);
  }
  return result;
}

struct RunSetup {
  std::vector<DeskObject> desk;
  std::vector<Visit> visits;
  double end_s = 0.0;
  SE3 T_odom_world;  ///< the odometry's world
  SE3 drift;         ///< applied on the left from `drift_from_s` on
  double drift_from_s = 1e9;
  double drift_scale = 1.0;  ///< of the odometry's translations, from then on
  bool drift_is_break = false;
  bool same_ids = false;  ///< later visits keep the landmark ids of the first
  double quality = 0.8;
  std::vector<LocalMap> earlier_map = {};
  std::optional<LoopOptions> changed = {};  ///< options that the detector is given at `changed_at_s`
  double changed_at_s = 0.0;
  std::pair<std::vector<LocalMap>, std::vector<KeyframePose>> restored = {};  ///< of an earlier session
  std::function<void(const LoopDetector&)> at_every_frame = {};
};

struct RunOutcome {
  std::vector<LoopClosure> loops;
  std::vector<SE3> T_world_camera;  ///< truth by frame_id
  std::vector<SE3> T_odom_camera;

  SE3 truth(const LoopClosure& loop) const { return relative(T_world_camera, loop); }
  SE3 odometry(const LoopClosure& loop) const { return relative(T_odom_camera, loop); }
  int accepted() const {
    int count = 0;
    for (const LoopClosure& loop : loops) count += loop.accepted ? 1 : 0;
    return count;
  }

 private:
  static SE3 relative(const std::vector<SE3>& poses, const LoopClosure& loop) {
    return poses[static_cast<std::size_t>(loop.match_frame)].inverse() *
           poses[static_cast<std::size_t>(loop.query_frame)];
  }
};

/// Feeds 10 Hz frames through a LoopDetector.   @param at_end is shown the detector after the last frame
inline RunOutcome run(const LoopOptions& options, const RunSetup& setup,
                      const std::function<void(const LoopDetector&)>& at_end = {}) {
  LoopDetector detector(options, desk_classes());
  if (!setup.earlier_map.empty()) detector.set_earlier_map(setup.earlier_map);
  if (!setup.restored.first.empty()) detector.restore(setup.restored.first, setup.restored.second, {});
  FrameBuilder builder(KeyframeOptions(), desk_camera());
  std::mt19937_64 random(7);
  RunOutcome outcome;
  MapUpdate qualities;
  for (std::int64_t id = 0; id < 1000; ++id) {
    Landmark landmark;
    landmark.id = id;
    landmark.quality = setup.quality;
    qualities.changed.push_back(landmark);
  }
  detector.apply(qualities);
  for (std::int64_t k = 0; static_cast<double>(k) * 0.1 < setup.end_s; ++k) {
    const double time_s = 0.1 * static_cast<double>(k);
    const SE3 T_world_camera = desk_pose(setup.visits, time_s);
    const bool drifted = time_s >= setup.drift_from_s;
    PoseSample sample;
    sample.stamp_ns = 1'000'000'000 + k * 100'000'000;
    sample.T_odom_camera = setup.T_odom_world * (drifted ? setup.drift * T_world_camera : T_world_camera);
    if (drifted) sample.T_odom_camera.t *= setup.drift_scale;
    sample.is_break = setup.drift_is_break && drifted && time_s < setup.drift_from_s + 0.1;
    if (setup.changed && time_s >= setup.changed_at_s) detector.set_options(*setup.changed);
    const auto frame = builder.build(sample);
    const std::int64_t first_id = drifted && !setup.same_ids ? 500 : 0;
    const AssociationFrame associations = observe(setup.desk, *frame, T_world_camera, first_id, random);
    const std::vector<LoopClosure> loops = detector.detect(*frame, associations);
    outcome.loops.insert(outcome.loops.end(), loops.begin(), loops.end());
    outcome.T_world_camera.push_back(T_world_camera);
    outcome.T_odom_camera.push_back(sample.T_odom_camera);
    if (setup.at_every_frame) setup.at_every_frame(detector);
  }
  if (at_end) at_end(detector);
  return outcome;
}

}  // namespace semantic_topo_loop::core::testing
