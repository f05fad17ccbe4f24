#include "tools/simulation/dynamics.h"

#include <algorithm>
#include <set>

#include "support/test_files.h"
#include "support/test_fixtures.h"
#include "tools/simulation/sequence.h"

namespace semantic_topo_loop::core {
namespace {

using simulation_test::camera_fr2;
using simulation_test::coco;
using simulation_test::options_of;

constexpr int kPerson = 0, kCup = 41;

std::optional<SimulatedSequence> simulate_texts(const std::map<std::string, std::string>& texts) {
  std::string error;
  auto sequence = simulate(options_of(texts), camera_fr2(), coco(), &error);
  EXPECT_TRUE(sequence) << error;
  return sequence;
}

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
  const auto sequence = simulate_texts({{"trajectory.duration_s", "1"}});
  EXPECT_TRUE(moving(sequence->scene).empty());
  EXPECT_TRUE(gone_objects(*sequence).empty());
  const std::string text = format_gone_objects(*sequence, coco());
  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 1) << text;
}

TEST(Dynamics, what_moves_leaves_the_rest_as_it_is) {
  const auto still = simulate_texts({{"trajectory.duration_s", "1"}});
  const auto moved =
      simulate_texts({{"trajectory.duration_s", "1"}, {"dynamics.persons", "2"}, {"dynamics.moved_objects", "1"}});
  ASSERT_EQ(moved->scene.objects.size(), still->scene.objects.size() + 2);
  for (std::size_t i = 0; i < still->scene.objects.size(); ++i) {
    const Vec3 at_begin = moved->scene.objects[i].at(0.0)->center();
    EXPECT_EQ(at_begin, still->scene.objects[i].ellipsoid.center());
  }
  EXPECT_EQ(moved->truth.back().T_world_camera.t, still->truth.back().T_world_camera.t);
  EXPECT_EQ(moved->odometry.back().T_world_camera.t, still->odometry.back().T_world_camera.t);
}

TEST(Dynamics, people_walk_upright_and_only_for_a_while) {
  const auto sequence = simulate_texts({{"trajectory.duration_s", "40"}, {"dynamics.persons", "4"}});
  const auto people = moving(sequence->scene);
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
        simulate_texts({{"scene.layout", layout}, {"trajectory.duration_s", "40"}, {"dynamics.persons", "4"}});
    Scene empty = sequence->scene;
    empty.objects.resize(empty.objects.size() - 4);
    const SceneProjector with(sequence->scene, sequence->camera), without(empty, sequence->camera);
    int hidden = 0, seen = 0;
    std::set<int> boxes_of;
    for (std::size_t frame = 0; frame < sequence->truth.size(); frame += 5) {
      const SE3& T = sequence->truth[frame].T_world_camera;
      const double time_s = sequence->time_s(frame);
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
        EXPECT_TRUE(sequence->scene.objects[i].at(time_s));
      }
      for (const SimulatedDetection& d : sequence->detections[frame]) {
        if (d.object >= static_cast<int>(b.size())) boxes_of.insert(d.object);
      }
    }
    EXPECT_GT(seen, 20) << layout;
    EXPECT_GT(hidden, 10) << layout;
    EXPECT_EQ(boxes_of.size(), 4u) << layout;
  }
}

TEST(Dynamics, people_are_no_reference_objects) {
  const auto sequence = simulate_texts({{"trajectory.duration_s", "20"}, {"dynamics.persons", "3"}});
  for (const SimulatedReference& reference : reference_objects(*sequence)) {
    EXPECT_NE(sequence->scene.objects[static_cast<std::size_t>(reference.object)].class_id, kPerson);
  }
  EXPECT_TRUE(gone_objects(*sequence).empty());
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
    const HandheldTrajectory trajectory(scene, {}, seed);
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
  const auto sequence = simulate_texts({{"trajectory.duration_s", "40"},
                                        {"trajectory.lap_s", "20"},
                                        {"dynamics.moved_objects", "1"},
                                        {"dynamics.move_time_s", "20"}});
  constexpr int kMoveFrame = 600;
  const auto gone = gone_objects(*sequence);
  ASSERT_EQ(gone.size(), 1u);
  const SceneObject& cup = sequence->scene.objects[static_cast<std::size_t>(gone[0].object)];
  EXPECT_EQ(gone[0].ellipsoid.center(), cup.at(0.0)->center());
  EXPECT_GT(gone[0].views, 60);
  EXPECT_LT(gone[0].last_frame, kMoveFrame);

  const auto references = reference_objects(*sequence);
  const auto it = std::find_if(references.begin(), references.end(),
                               [&](const SimulatedReference& r) { return r.object == gone[0].object; });
  ASSERT_NE(it, references.end());
  EXPECT_GE(it->first_frame, kMoveFrame);
  EXPECT_GT(it->mean_iou, 0.7);
  int boxes = 0;
  for (const auto& frame : sequence->detections) {
    for (const SimulatedDetection& d : frame) boxes += d.object == gone[0].object ? 1 : 0;
  }
  EXPECT_EQ(it->views + gone[0].views, boxes);

  const std::string row = std::to_string(it - references.begin());
  const std::string text = format_gone_objects(*sequence, coco());
  EXPECT_EQ(text.substr(text.size() - row.size() - 2), "," + row + "\n") << text;
  EXPECT_NE(text.find("\n0,41,cup,"), std::string::npos) << text;
}

TEST(Dynamics, files_say_what_is_gone) {
  const TestDirectory directory;
  const auto sequence = simulate_texts({{"trajectory.duration_s", "4"},
                                        {"dynamics.persons", "1"},
                                        {"dynamics.moved_objects", "1"},
                                        {"dynamics.move_time_s", "2"}});
  std::string error;
  ASSERT_TRUE(write_sequence(*sequence, coco(), directory.path("a"), &error)) << error;
  EXPECT_EQ(read_whole(directory.path("a/gone_objects.csv")), format_gone_objects(*sequence, coco()));
  EXPECT_EQ(read_whole(directory.path("a/reference_objects.csv")).find("person"), std::string::npos);
}

TEST(Dynamics, values_out_of_range_are_named) {
  for (const auto& [key, value] : {std::pair("dynamics.persons", "-1"), std::pair("dynamics.moved_objects", "-2"),
                                   std::pair("dynamics.move_time_s", "0")}) {
    const std::string error = make_options<SimulationOptions>({{key, value}}).message();
    EXPECT_NE(error.find("'" + std::string(key) + "' = '" + value + "'"), std::string::npos) << error;
  }
}

}  // namespace
}  // namespace semantic_topo_loop::core
