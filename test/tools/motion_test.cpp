#include "tools/simulation/motion.h"

#include <algorithm>
#include <set>

#include "semantic_topo_loop/geometry/lie.h"
#include "support/test_files.h"
#include "support/test_fixtures.h"
#include "tools/perturbation/perturbation.h"

namespace semantic_topo_loop::core {
namespace {

using simulation_test::simulate_fr2;

std::vector<SE3> poses(const std::string& layout, std::uint64_t seed, double duration_s = 60.0) {
  SceneOptions scene_options;
  scene_options.layout = layout;
  TrajectoryOptions options;
  options.duration_s = duration_s;
  const auto trajectory = make_trajectory(make_scene(scene_options, seed), options, seed);
  std::vector<SE3> result;
  for (double i = 0.0; i < duration_s * options.rate_hz; i += 1.0) {
    result.push_back(trajectory(i / options.rate_hz));
  }
  return result;
}

class TrajectoryTest : public ::testing::TestWithParam<std::string> {};

TEST_P(TrajectoryTest, looks_at_a_desk_from_above_with_the_image_upright) {
  for (std::uint64_t seed = 0; seed < 10; ++seed) {
    SceneOptions scene_options;
    scene_options.layout = GetParam();
    const Scene scene = make_scene(scene_options, seed);
    for (const SE3& T : poses(GetParam(), seed)) {
      EXPECT_GT(T.t.z(), 0.9);
      EXPECT_LT((T.q * Vec3::UnitY()).z(), -0.5) << "y points down";
      double nearest_deg = 180.0;
      for (const Desk& desk : scene.desks) {
        const Vec3 seen = T.inverse() * desk.T_world_desk.t;
        nearest_deg = std::min(nearest_deg, degrees(std::atan2(seen.head<2>().norm(), seen.z())));
      }
      EXPECT_LT(nearest_deg, 45.0);
    }
  }
}

TEST(Trajectory, goes_round_the_desks_it_is_to_visit) {
  SceneOptions scene_options;
  scene_options.layout = "house";
  scene_options.desks = 6;
  const Scene scene = make_scene(scene_options, 3);
  for (const char* model : {"handheld", "robot"}) {
    TrajectoryOptions options;
    options.model = model;
    options.first_desk = 2;
    options.desks = 3;
    const auto trajectory = make_trajectory(scene, options, 3);
    std::set<int> rooms;
    for (double time_s = 0.0; time_s < options.lap_s; time_s += 0.1) rooms.insert(scene.room_of(trajectory(time_s).t));
    EXPECT_EQ(rooms, (std::set<int>{1, 2, 3})) << model;
  }
}

TEST_P(TrajectoryTest, moves_as_smoothly_as_a_hand) {
  for (std::uint64_t seed = 0; seed < 10; ++seed) {
    const std::vector<SE3> T = poses(GetParam(), seed);
    for (std::size_t i = 2; i < T.size(); ++i) {
      EXPECT_LT((T[i].t - T[i - 1].t).norm() * 30.0, 1.5) << "m/s, seed " << seed << ", frame " << i;
      EXPECT_LT(degrees(rotation_angle(T[i].q, T[i - 1].q)) * 30.0, 90.0) << "deg/s, seed " << seed << ", frame " << i;
      const Vec3 acceleration = (T[i].t - 2.0 * T[i - 1].t + T[i - 2].t) * 900.0;
      EXPECT_LT(acceleration.norm(), 15.0) << "m/s^2, seed " << seed << ", frame " << i;
    }
  }
}

TEST_P(TrajectoryTest, revisits_after_more_than_a_thousand_frames) {
  for (std::uint64_t seed = 0; seed < 10; ++seed) {
    const std::vector<SE3> T = poses(GetParam(), seed);
    int revisits = 0;
    for (std::size_t i = 1001; i < T.size(); ++i) {
      const bool revisit =
          std::any_of(T.begin(), T.begin() + static_cast<std::ptrdiff_t>(i - 1000), [&](const SE3& old) {
            const double angle = std::acos(std::clamp((T[i].q * Vec3::UnitZ()).dot(old.q * Vec3::UnitZ()), -1.0, 1.0));
            return (T[i].t - old.t).norm() < 0.8 && degrees(angle) < 25.0;
          });
      revisits += revisit ? 1 : 0;
    }
    EXPECT_GT(revisits, 400) << "seed " << seed;
  }
}

INSTANTIATE_TEST_SUITE_P(Layouts, TrajectoryTest, ::testing::Values("desk", "office"));

struct Level {
  std::string model;
  double position_m, rotation_deg;
};

class DriftTest : public ::testing::TestWithParam<Level> {};

TEST_P(DriftTest, reaches_the_level_exactly) {
  for (std::uint64_t seed = 0; seed < 6; ++seed) {
    const std::vector<SE3> truth = poses(seed % 2 == 0 ? "desk" : "office", seed);
    DriftOptions options;
    options.model = GetParam().model;
    options.position_m = GetParam().position_m;
    options.rotation_deg = GetParam().rotation_deg;
    const auto drifted = drift_poses(truth, options, seed);
    ASSERT_TRUE(drifted) << drifted.message();
    ASSERT_EQ(drifted->size(), truth.size());
    EXPECT_EQ(drifted->front().t, truth.front().t);
    double position_m = 0.0, rotation_deg = 0.0;
    for (std::size_t i = 0; i < truth.size(); ++i) {
      position_m = std::max(position_m, ((*drifted)[i].t - truth[i].t).norm());
      rotation_deg = std::max(rotation_deg, degrees(rotation_angle((*drifted)[i].q, truth[i].q)));
    }
    EXPECT_NEAR(position_m, options.position_m, 1e-3 * options.position_m + 1e-9);
    EXPECT_NEAR(rotation_deg, options.rotation_deg, 1e-3 * options.rotation_deg + 1e-9);
  }
}

INSTANTIATE_TEST_SUITE_P(Levels, DriftTest,
                         ::testing::Values(Level{"smooth", 0.3, 5.0}, Level{"smooth", 1.0, 15.0},
                                           Level{"smooth", 2.0, 30.0}, Level{"smooth", 0.5, 0.0},
                                           Level{"jump", 0.3, 5.0}, Level{"jump", 1.0, 15.0},
                                           Level{"jump", 2.0, 30.0}));

TEST(Drift, level_zero_is_exact) {
  const std::vector<SE3> truth = poses("desk", 1, 5.0);
  for (const char* model : {"smooth", "jump"}) {
    DriftOptions options;
    options.model = model;
    options.position_m = options.rotation_deg = 0.0;
    const auto drifted = drift_poses(truth, options, 1);
    ASSERT_TRUE(drifted);
    for (std::size_t i = 0; i < truth.size(); ++i) {
      EXPECT_EQ((*drifted)[i].t, truth[i].t);
      EXPECT_EQ((*drifted)[i].q.coeffs(), truth[i].q.coeffs());
    }
  }
}

/// Error of the motion over one frame.
double step_error_m(const std::vector<SE3>& truth, const std::vector<SE3>& drifted, std::size_t i) {
  return ((drifted[i].inverse() * drifted[i + 1]).t - (truth[i].inverse() * truth[i + 1]).t).norm();
}

TEST(Drift, jump_is_good_but_for_three_bursts) {
  const std::vector<SE3> truth = poses("desk", 2);
  DriftOptions options;
  options.model = "jump";
  options.position_m = 1.0;
  options.rotation_deg = 15.0;
  const auto drifted = drift_poses(truth, options, 7);
  ASSERT_TRUE(drifted);
  int bad = 0;
  for (std::size_t i = 0; i + 1 < truth.size(); ++i) bad += step_error_m(truth, *drifted, i) > 0.005 ? 1 : 0;
  EXPECT_GT(bad, 0);
  EXPECT_LE(bad, 24);
}

TEST(Drift, the_scale_walks_as_far_as_it_is_told_and_the_rotation_stays) {
  const std::vector<SE3> truth = poses("desk", 3);
  DriftOptions options;
  options.scale_percent = 20.0;
  options.global_scale = 0.5;
  for (std::uint64_t seed = 0; seed < 4; ++seed) {
    const std::vector<SE3> drifted = drift_scale(truth, options, seed);
    ASSERT_EQ(drifted.size(), truth.size());
    double largest = 0.0;
    for (std::size_t i = 1; i < truth.size(); ++i) {
      const double true_m = (truth[i].t - truth[i - 1].t).norm(), step = (drifted[i].t - drifted[i - 1].t).norm();
      if (true_m > 1e-6) largest = std::max(largest, std::abs(std::log(step / (0.5 * true_m))));
      EXPECT_LT(rotation_angle(drifted[i].q, truth[i].q), 1e-6);
    }
    EXPECT_NEAR(largest, std::log(1.2), 1e-3);
  }
  EXPECT_NE(drift_scale(truth, options, 1).back().t, drift_scale(truth, options, 2).back().t);
  EXPECT_EQ(drift_scale(truth, {}, 1).back().t, truth.back().t) << "none unless it is asked for";
}

TEST(Drift, a_level_that_cannot_be_met_is_an_error_with_both_values) {
  DriftOptions options;
  options.position_m = 0.001;
  options.rotation_deg = 60.0;
  const std::string error = drift_poses(poses("desk", 1), options, 1).message();
  EXPECT_NE(error.find("'drift.position_m' = '0.001'"), std::string::npos) << error;
  EXPECT_NE(error.find("'60'"), std::string::npos) << error;
}

TEST(HandheldTrajectory, an_arc_swings_to_and_fro) {
  const Scene scene = make_scene({}, 2);
  TrajectoryOptions options;
  options.arc_deg = 90.0;
  options.wander_m = 0.0;
  const auto trajectory = make_trajectory(scene, options, 2);
  const Vec3& center = scene.desks[0].T_world_desk.t;
  const auto direction = [&](double time_s) { return Vec2((trajectory(time_s).t - center).head<2>().normalized()); };
  double widest_deg = 0.0;
  for (double time_s = 0.0; time_s < 36.0; time_s += 0.5) {
    widest_deg = std::max(widest_deg, degrees(std::acos(std::min(1.0, direction(0.0).dot(direction(time_s))))));
  }
  EXPECT_NEAR(widest_deg, 45.0, 2.0) << "half the arc to either side of the first place";
  EXPECT_GT(direction(0.0).dot(direction(18.0)), std::cos(radians(2.0))) << "back after half a period";
}

TEST(RobotTrajectory, keeps_height_and_tilt_and_heads_where_it_drives) {
  for (std::uint64_t seed = 0; seed < 6; ++seed) {
    SceneOptions scene_options;
    scene_options.layout = seed % 2 == 0 ? "desk" : "office";
    TrajectoryOptions options;
    options.model = "robot";
    const Scene scene = make_scene(scene_options, seed);
    const CameraTrajectory trajectory = make_trajectory(scene, options, seed);
    double slowest = 1e9, fastest = 0.0, turn_standing = 0.0;
    for (double time_s = 0.0; time_s < 60.0; time_s += 1.0 / 30.0) {
      const SE3 T = trajectory(time_s), next = trajectory(time_s + 1e-3);
      EXPECT_EQ(T.t.z(), options.height_m);
      EXPECT_NEAR((T.q * Vec3::UnitX()).z(), 0.0, 1e-9) << "no roll";
      EXPECT_NEAR((T.q * Vec3::UnitZ()).z(), -std::sin(radians(18.0)), 1e-9) << "constant tilt";
      const Vec3 velocity = (next.t - T.t) * 1e3;
      const double turn = degrees(rotation_angle(T.q, next.q)) * 1e3;
      EXPECT_LT(turn, 90.0);
      slowest = std::min(slowest, velocity.norm());
      fastest = std::max(fastest, velocity.norm());
      if (velocity.norm() < 0.02) turn_standing = std::max(turn_standing, turn);
      if (velocity.norm() < 0.05) continue;
      const Vec3 ahead = (T.q * Vec3::UnitZ()).cwiseProduct(Vec3(1.0, 1.0, 0.0)).normalized();
      const double aside_deg = degrees(std::acos(std::clamp(ahead.dot(velocity.normalized()), -1.0, 1.0)));
      EXPECT_NEAR(aside_deg, 55.0, 36.0) << "the camera's mount, and the turns at stops";
    }
    EXPECT_LT(slowest, 0.02) << "it stops";
    EXPECT_LT(fastest, 1.5);
    EXPECT_GT(fastest, 0.3);
    EXPECT_GT(turn_standing, 15.0) << "and turns on the spot";
  }
}

constexpr int kPerson = 0, kCup = 41;

/// The desk whose top an object stands on; -1 for none.
int desk_below(const Scene& scene, const Ellipsoid& e) {
  for (std::size_t i = 0; i < scene.desks.size(); ++i) {
    const Vec3 p = scene.desks[i].T_world_desk.inverse() * e.center();
    if (std::abs(p.x()) < scene.desks[i].half_depth_m && std::abs(p.y()) < scene.desks[i].half_width_m &&
        std::abs(p.z() - e.semi_axes.z()) < 1e-9) {
      return static_cast<int>(i);
    }
  }
  return -1;
}

std::vector<const SceneObject*> moving(const Scene& scene) {
  std::vector<const SceneObject*> objects;
  for (const SceneObject& object : scene.objects) {
    if (!object.phases.empty()) objects.push_back(&object);
  }
  return objects;
}

TEST(RobotTrajectory, stands_where_it_is_parked_and_drives_on) {
  TrajectoryOptions options;
  options.model = "robot";
  options.parked_share = 0.25;  // the last 450 s of 1800
  const Scene scene = make_scene({}, 1);
  const auto parked = make_trajectory(scene, options, 1);
  options.parked_share = 0.0;
  const auto driving = make_trajectory(scene, options, 1);
  const auto distance_m = [&](double parked_s, double driving_s) {
    return (parked(parked_s).inverse() * driving(driving_s)).t.norm();
  };
  for (const double time_s : {0.0, 700.0, 1349.0}) EXPECT_NEAR(distance_m(time_s, time_s), 0.0, 1e-9) << time_s;
  for (const double time_s : {1350.0, 1500.0, 1799.9}) EXPECT_NEAR(distance_m(time_s, 1350.0), 0.0, 1e-9) << time_s;
  EXPECT_NEAR(distance_m(1800.0 + 700.0, 1350.0 + 700.0), 0.0, 1e-9);
}

TEST(SceneObject, at_follows_the_phases) {
  SceneObject object;
  object.ellipsoid.T_world_quadric.t = Vec3(9.0, 0.0, 0.0);
  EXPECT_EQ(object.at(5.0)->center(), Vec3(9.0, 0.0, 0.0));
  EXPECT_TRUE(object.stays());

  ObjectPhase rest, walk, absent;
  rest.T_world_object.t = Vec3(1.0, 2.0, 3.0);
  walk.begin_s = 4.0;
  walk.velocity = Vec3(0.5, 0.0, -1.0);
  absent.begin_s = 6.0;
  absent.is_present = false;
  object.phases = {rest, walk, absent};
  EXPECT_EQ(object.at(-1.0)->center(), Vec3(1.0, 2.0, 3.0));
  EXPECT_EQ(object.at(3.999)->center(), Vec3(1.0, 2.0, 3.0));
  EXPECT_EQ(object.at(5.0)->center(), Vec3(0.5, 0.0, -1.0));
  EXPECT_FALSE(object.at(6.0));
  EXPECT_FALSE(object.stays());
  object.phases.pop_back();
  EXPECT_FALSE(object.stays());
  object.phases = {walk, rest};
  EXPECT_TRUE(object.stays());
}

TEST(Dynamics, nothing_moves_unless_asked_for) {
  const SimulatedSequence sequence = simulate_fr2({{"trajectory.duration_s", "1"}});
  EXPECT_TRUE(moving(sequence.scene).empty());
  EXPECT_TRUE(gone_objects(sequence).empty());
  const std::string text = format_gone_objects(sequence, coco());
  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 1) << text;
}

TEST(Dynamics, what_would_move_after_the_end_is_an_error) {
  const auto options =
      make_options<SimulationOptions>({{"trajectory.duration_s", "30"}, {"dynamics.new_objects", "1"}});
  EXPECT_EQ(options.message(), "parameter 'dynamics.move_time_s' = '36' must be before the end of the sequence");
}

TEST(Dynamics, what_moves_leaves_the_rest_as_it_is) {
  const SimulatedSequence still = simulate_fr2({{"trajectory.duration_s", "1"}});
  const SimulatedSequence moved = simulate_fr2({{"trajectory.duration_s", "1"},
                                                {"dynamics.persons", "2"},
                                                {"dynamics.moved_objects", "1"},
                                                {"dynamics.move_time_s", "0.5"}});
  ASSERT_EQ(moved.scene.objects.size(), still.scene.objects.size() + 2);
  for (std::size_t i = 0; i < still.scene.objects.size(); ++i) {
    const Vec3 at_begin = moved.scene.objects[i].at(0.0)->center();
    EXPECT_EQ(at_begin, still.scene.objects[i].ellipsoid.center());
  }
  EXPECT_EQ(moved.truth.back().T_world_camera.t, still.truth.back().T_world_camera.t);
  EXPECT_EQ(moved.odometry.back().T_world_camera.t, still.odometry.back().T_world_camera.t);
}

TEST(Dynamics, people_walk_upright_and_only_for_a_while) {
  const SimulatedSequence sequence = simulate_fr2({{"trajectory.duration_s", "40"}, {"dynamics.persons", "4"}});
  const auto people = moving(sequence.scene);
  ASSERT_EQ(people.size(), 4u);
  for (std::size_t i = 0; i < people.size(); ++i) {
    EXPECT_EQ(people[i]->class_id, kPerson);
    EXPECT_FALSE(people[i]->stays());
    const double middle_s = 10.0 * (static_cast<double>(i) + 0.5);
    EXPECT_FALSE(people[i]->at(middle_s - 3.1));
    EXPECT_FALSE(people[i]->at(middle_s + 3.1));
    const auto before = people[i]->at(middle_s - 1.0), after = people[i]->at(middle_s + 1.0);
    ASSERT_TRUE(before && after);
    EXPECT_NEAR((after->center() - before->center()).norm(), 2.4, 1e-9);
    EXPECT_NEAR(before->center().z(), before->semi_axes.z(), 1e-12);  // feet on the floor
    EXPECT_NEAR(after->center().z(), before->center().z(), 1e-12);
    EXPECT_NEAR((after->T_world_quadric.q * Vec3::UnitZ()).z(), 1.0, 1e-12);
  }
}

TEST(Dynamics, people_come_into_view_and_hide_what_is_behind) {
  for (const char* layout : {"desk", "office"}) {
    const auto sequence =
        simulate_fr2({{"scene.layout", layout}, {"trajectory.duration_s", "40"}, {"dynamics.persons", "4"}});
    Scene empty = sequence.scene;
    empty.objects.resize(empty.objects.size() - 4);
    const SceneProjector with(sequence.scene, sequence.camera), without(empty, sequence.camera);
    int hidden = 0, seen = 0;
    std::set<int> boxes_of;
    for (std::size_t frame = 0; frame < sequence.truth.size(); frame += 5) {
      const SE3& T = sequence.truth[frame].T_world_camera;
      const double time_s = sequence.time_s(frame);
      const auto a = with.project(T, time_s), b = without.project(T, time_s);
      for (std::size_t i = 0; i < b.size(); ++i) {
        if (!b[i]) continue;
        ASSERT_TRUE(a[i]);
        EXPECT_LE(a[i]->visible, b[i]->visible);
        hidden += a[i]->visible < 0.5 * b[i]->visible ? 1 : 0;
      }
      for (std::size_t i = b.size(); i < a.size(); ++i) {
        if (!a[i]) continue;
        ++seen;
        EXPECT_TRUE(sequence.scene.objects[i].at(time_s));
      }
      for (const SimulatedDetection& d : sequence.detections[frame]) {
        if (d.object >= static_cast<int>(b.size())) boxes_of.insert(d.object);
      }
    }
    EXPECT_GT(seen, 20) << layout;
    EXPECT_GT(hidden, 10) << layout;
    EXPECT_EQ(boxes_of.size(), 4u) << layout;
  }
}

TEST(Dynamics, people_are_no_reference_objects) {
  const SimulatedSequence sequence = simulate_fr2({{"trajectory.duration_s", "20"}, {"dynamics.persons", "3"}});
  for (const SimulatedReference& reference : reference_objects(sequence)) {
    EXPECT_NE(sequence.scene.objects[static_cast<std::size_t>(reference.object)].class_id, kPerson);
  }
  EXPECT_TRUE(gone_objects(sequence).empty());
}

class MovedObjects : public ::testing::TestWithParam<std::string> {};

TEST_P(MovedObjects, stand_free_on_another_surface) {
  SceneOptions options;
  options.layout = GetParam();
  DynamicsOptions dynamics;
  dynamics.moved_objects = 2;
  dynamics.move_time_s = 10.0;
  for (std::uint64_t seed = 0; seed < 30; ++seed) {
    Scene scene = make_scene(options, seed);
    const auto trajectory = make_trajectory(scene, {}, seed);
    add_dynamics(dynamics, trajectory, 20.0, seed, &scene);
    const auto moved = moving(scene);
    ASSERT_EQ(moved.size(), 2u) << "seed " << seed;
    for (const SceneObject* object : moved) {
      EXPECT_EQ(object->class_id, kCup);
      const Ellipsoid before = *object->at(9.9), after = *object->at(10.0);
      EXPECT_EQ(after.center(), object->ellipsoid.center());
      EXPECT_GT((after.center() - before.center()).norm(), 0.5);
      EXPECT_GE(desk_below(scene, before), 0);
      EXPECT_GE(desk_below(scene, after), 0);
      EXPECT_EQ(desk_below(scene, before) == desk_below(scene, after), scene.desks.size() == 1);
      for (const SceneObject& other : scene.objects) {
        if (&other == object) continue;
        for (const double time_s : {0.0, 15.0}) {
          const Vec3 offset = object->at(time_s)->center() - other.at(time_s)->center();
          const double reach = other.ellipsoid.semi_axes.head<2>().minCoeff() + object->ellipsoid.semi_axes.x();
          EXPECT_GT(offset.head<2>().norm(), reach) << "seed " << seed;
        }
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Layouts, MovedObjects, ::testing::Values("desk", "office"));

TEST(Dynamics, truth_states_the_final_place_and_the_one_that_is_gone) {
  const SimulatedSequence sequence = simulate_fr2({{"trajectory.duration_s", "40"},
                                                   {"trajectory.lap_s", "20"},
                                                   {"dynamics.moved_objects", "1"},
                                                   {"dynamics.move_time_s", "20"}});
  constexpr int kMoveFrame = 600;
  const auto gone = gone_objects(sequence);
  ASSERT_EQ(gone.size(), 1u);
  const SceneObject& cup = sequence.scene.objects[static_cast<std::size_t>(gone[0].object)];
  EXPECT_EQ(gone[0].ellipsoid.center(), cup.at(0.0)->center());
  EXPECT_GT(gone[0].views, 60);
  EXPECT_LT(gone[0].last_frame, kMoveFrame);

  const auto references = reference_objects(sequence);
  const auto it = std::find_if(references.begin(), references.end(),
                               [&](const SimulatedReference& r) { return r.object == gone[0].object; });
  ASSERT_NE(it, references.end());
  EXPECT_GE(it->first_frame, kMoveFrame);
  EXPECT_GT(it->mean_iou, 0.7);
  int boxes = 0;
  for (const auto& frame : sequence.detections) {
    for (const SimulatedDetection& d : frame) boxes += d.object == gone[0].object ? 1 : 0;
  }
  EXPECT_EQ(it->views + gone[0].views, boxes);

  const std::string row = std::to_string(it - references.begin());
  const std::string text = format_gone_objects(sequence, coco());
  EXPECT_EQ(text.substr(text.size() - row.size() - 2), "," + row + "\n") << text;
  EXPECT_NE(text.find("\n0,41,cup,"), std::string::npos) << text;
}

TEST(Dynamics, files_say_what_is_gone) {
  const TestDirectory directory;
  const SimulatedSequence sequence = simulate_fr2({{"trajectory.duration_s", "4"},
                                                   {"dynamics.persons", "1"},
                                                   {"dynamics.moved_objects", "1"},
                                                   {"dynamics.move_time_s", "2"}});
  ASSERT_EQ(write_sequence(sequence, coco(), directory.path("a")).message(), "");
  EXPECT_EQ(read_whole(directory.path("a/gone_objects.csv")), format_gone_objects(sequence, coco()));
  EXPECT_EQ(read_whole(directory.path("a/reference_objects.csv")).find("person"), std::string::npos);
}

}  // namespace
}  // namespace semantic_topo_loop::core
