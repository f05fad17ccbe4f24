#include <algorithm>
#include <set>

#include "semantic_topo_loop/geometry/quadric.h"
#include "support/test_fixtures.h"
#include "tools/simulation/detector.h"

namespace semantic_topo_loop::core {
namespace {

using simulation_test::looking_along_x;
using simulation_test::perfect_detector;
using simulation_test::simulate_fr2;
using simulation_test::turned_object;

/// Largest value over s in (0, 1) of s (1-s) r^T [(1-s) A + s B]^-1 r: above 1 if and only if the ellipsoids with
/// shapes A, B and centres r apart are disjoint (Perram and Wertheim 1985).
double separation(const Ellipsoid& a, const Ellipsoid& b) {
  const Vec3 r = b.center() - a.center();
  double best = 0.0;
  for (double s = 0.01; s < 1.0; s += 0.01) {
    const Mat3 shape = (1.0 - s) * a.shape() + s * b.shape();
    best = std::max(best, s * (1.0 - s) * r.dot(shape.inverse() * r));
  }
  return best;
}

/// Height of the surface below an object's centre: a desk's top or the floor.
double surface_height(const Scene& scene, const SceneObject& object) {
  for (const Desk& desk : scene.desks) {
    const Vec3 p = desk.T_world_desk.inverse() * object.ellipsoid.center();
    if (p.z() > 0.0 && std::abs(p.x()) < desk.half_depth_m && std::abs(p.y()) < desk.half_width_m) {
      return desk.T_world_desk.t.z();
    }
  }
  return 0.0;
}

class SceneTest : public ::testing::TestWithParam<std::string> {
 protected:
  static Scene make(std::uint64_t seed) {
    SceneOptions options;
    options.layout = GetParam();
    return make_scene(options, seed);
  }
};

TEST_P(SceneTest, objects_do_not_overlap) {
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    const Scene scene = make(seed);
    for (std::size_t i = 0; i < scene.objects.size(); ++i) {
      for (std::size_t j = 0; j < i; ++j) {
        EXPECT_GT(separation(scene.objects[i].ellipsoid, scene.objects[j].ellipsoid), 1.0)
            << "seed " << seed << ", objects " << i << " and " << j;
      }
    }
  }
}

TEST_P(SceneTest, objects_rest_on_desk_or_floor) {
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    const Scene scene = make(seed);
    for (const SceneObject& object : scene.objects) {
      const Ellipsoid& e = object.ellipsoid;
      EXPECT_NEAR(e.center().z() - e.semi_axes.z(), surface_height(scene, object), 1e-9);
      EXPECT_NEAR((e.T_world_quadric.q * Vec3::UnitZ()).z(), 1.0, 1e-12);
    }
  }
}

TEST_P(SceneTest, objects_have_plausible_sizes_and_known_classes) {
  const ClassTable classes = coco();
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    for (const SceneObject& object : make(seed).objects) {
      const ObjectClass* entry = classes.find(object.class_id);
      ASSERT_NE(entry, nullptr) << object.class_id;
      EXPECT_TRUE(classes.is_mappable(object.class_id)) << entry->name;
      const double diameter = 2.0 * object.ellipsoid.semi_axes.maxCoeff();
      EXPECT_GT(diameter, 0.4 * entry->size_prior_m) << entry->name;
      EXPECT_LT(diameter, 2.5 * entry->size_prior_m) << entry->name;
    }
  }
}

TEST_P(SceneTest, every_desk_has_enough_objects_to_be_recognised) {
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    const Scene scene = make(seed);
    for (const Desk& desk : scene.desks) {
      std::set<int> labels;
      int count = 0;
      for (const SceneObject& object : scene.objects) {
        const Vec3 p = desk.T_world_desk.inverse() * object.ellipsoid.center();
        if (p.z() < 0.0 || std::abs(p.x()) > desk.half_depth_m || std::abs(p.y()) > desk.half_width_m) continue;
        labels.insert(object.class_id);
        ++count;
      }
      EXPECT_GE(count, 7) << "seed " << seed;
      EXPECT_GE(labels.size(), 5u) << "seed " << seed;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Layouts, SceneTest, ::testing::Values("desk", "office", "house"));

TEST(Scene, office_has_the_desks_asked_for) {
  SceneOptions options;
  options.layout = "office";
  options.desks = 5;
  EXPECT_EQ(make_scene(options, 1).desks.size(), 5u);
}

TEST(Scene, a_house_has_a_room_a_desk_and_its_walls_hide_the_others) {
  SceneOptions options;
  options.layout = "house";
  options.desks = 30;
  const Scene scene = make_scene(options, 1);
  EXPECT_EQ(scene.desks.size(), 30u);
  EXPECT_GE(scene.objects.size(), 570u);
  std::map<int, int> objects_of;
  for (const SceneObject& object : scene.objects) ++objects_of[scene.room_of(object.ellipsoid.center())];
  EXPECT_EQ(objects_of.size(), 30u);

  const SimulatedSequence sequence = simulate_fr2({{"scene.layout", "house"},
                                                   {"scene.desks", "4"},
                                                   {"trajectory.model", "robot"},
                                                   {"trajectory.lap_s", "40"},
                                                   {"trajectory.duration_s", "40"},
                                                   {"trajectory.rate_hz", "5"},
                                                   {"drift.position_m", "0"},
                                                   {"drift.rotation_deg", "0"}});
  std::set<int> rooms;
  for (std::size_t i = 0; i < sequence.truth.size(); ++i) {
    const int room = sequence.scene.room_of(sequence.truth[i].T_world_camera.t);
    rooms.insert(room);
    for (const SimulatedDetection& d : sequence.detections[i]) {
      if (d.object < 0) continue;
      const SceneObject& object = sequence.scene.objects[static_cast<std::size_t>(d.object)];
      EXPECT_EQ(sequence.scene.room_of(object.ellipsoid.center()), room) << "image " << i;
    }
  }
  EXPECT_EQ(rooms.size(), 4u) << "the lap goes through every room";
}

TEST(Scene, identical_desks_carry_the_same_objects) {
  SceneOptions options;
  options.layout = "office";
  options.identical_desks = true;
  const Scene scene = make_scene(options, 3);
  const SE3 T_desk1_desk0 = scene.desks[1].T_world_desk * scene.desks[0].T_world_desk.inverse();
  int on_first = 0;
  for (const SceneObject& object : scene.objects) {
    const Vec3 p = scene.desks[0].T_world_desk.inverse() * object.ellipsoid.center();
    if (p.z() < 0.0 || std::abs(p.x()) > 0.5 || std::abs(p.y()) > 1.0) continue;
    ++on_first;
    const Vec3 expected = T_desk1_desk0 * object.ellipsoid.center();
    const bool found = std::any_of(scene.objects.begin(), scene.objects.end(), [&](const SceneObject& other) {
      return other.class_id == object.class_id && (other.ellipsoid.center() - expected).norm() < 1e-9 &&
             other.ellipsoid.semi_axes == object.ellipsoid.semi_axes;
    });
    EXPECT_TRUE(found) << object.class_id;
  }
  EXPECT_GE(on_first, 7);
}

TEST(Scene, seeds_give_different_scenes) {
  const Scene a = make_scene({}, 1), b = make_scene({}, 2);
  EXPECT_GT((a.objects[0].ellipsoid.center() - b.objects[0].ellipsoid.center()).norm(), 1e-3);
}

constexpr int kCup = 41, kVase = 75, kTv = 62;

Camera pinhole() {
  Camera camera = camera_fr2();
  camera.distortion = {};
  return camera;
}

/// A desk far away, so that it hides nothing.
Scene scene_of(const std::vector<SceneObject>& objects) {
  Scene scene;
  Desk desk;
  desk.T_world_desk.t = Vec3(-50.0, 0.0, 0.74);
  desk.half_depth_m = desk.half_width_m = 0.5;
  scene.desks = {desk};
  scene.objects = objects;
  return scene;
}

/// A wall of equal objects, 3 m away, that do not hide each other.
Scene wall(int class_id, int columns, int rows) {
  std::vector<SceneObject> objects;
  for (int i = 0; i < columns * rows; ++i) {
    const double y = 0.22 * (i % columns - 0.5 * (columns - 1)), z = 1.2 + 0.22 * (i / columns - 0.5 * (rows - 1));
    objects.push_back(turned_object(class_id, {3.0, y, z}, {0.08, 0.08, 0.08}));
  }
  return scene_of(objects);
}

std::vector<SimulatedDetection> detect_once(const Scene& scene, const Camera& camera, const DetectorOptions& options,
                                            const SE3& T_world_camera) {
  return DetectorModel(scene, camera, coco(), options, 30.0, 1).detect(T_world_camera);
}

TEST(Detector, clean_boxes_equal_project_box) {
  const Camera camera = pinhole();
  for (const char* layout : {"desk", "office"}) {
    SceneOptions scene_options;
    scene_options.layout = layout;
    const Scene scene = make_scene(scene_options, 5);
    const auto trajectory = make_trajectory(scene, {}, 5);
    DetectorModel model(scene, camera, coco(), perfect_detector(), 30.0, 1);
    const SceneProjector projector(scene, camera);
    int compared = 0;
    for (double time_s = 0.0; time_s < 36.0; time_s += 0.5) {
      const SE3 T = trajectory(time_s);
      const auto views = projector.project(T);
      for (const SimulatedDetection& d : model.detect(T)) {
        const auto i = static_cast<std::size_t>(d.object);
        EXPECT_EQ(d.detection.class_id, scene.objects[i].class_id);
        if (views[i]->visible < 1.0) continue;
        const auto box = project_box(scene.objects[i].ellipsoid, projection_matrix(camera, T));
        ASSERT_TRUE(box);
        const Vec4 expected = clip(*box, camera.width, camera.height).edges();
        EXPECT_LT((d.detection.box.edges() - expected).cwiseAbs().maxCoeff(), 1e-6);
        ++compared;
      }
    }
    EXPECT_GT(compared, 200);
  }
}

TEST(Detector, boxes_are_of_the_distorted_image) {
  const Camera camera = camera_fr2();
  const SE3 T = looking_along_x({0.0, 0.0, 1.2});
  for (const Vec3& center : {Vec3(2.0, 0.9, 1.7), Vec3(2.0, -0.8, 0.8), Vec3(2.0, 0.0, 1.2)}) {
    const Scene scene = scene_of({turned_object(kCup, center, {0.05, 0.08, 0.06})});
    const auto detections = detect_once(scene, camera, perfect_detector(), T);
    ASSERT_EQ(detections.size(), 1u);
    // The outline itself, pushed through the lens point by point.
    Box outline{1e9, 1e9, -1e9, -1e9};
    const Mat34 P = projection_matrix(camera, T);
    const Ellipsoid& e = scene.objects[0].ellipsoid;
    for (double lat = -90.0; lat <= 90.0; lat += 1.0) {
      for (double lon = 0.0; lon < 360.0; lon += 1.0) {
        const Vec3 unit(std::cos(radians(lat)) * std::cos(radians(lon)),
                        std::cos(radians(lat)) * std::sin(radians(lon)), std::sin(radians(lat)));
        const Vec3 image = P * (e.T_world_quadric * Vec3(unit.cwiseProduct(e.semi_axes))).homogeneous();
        const Vec2 p = camera.distort(image.hnormalized());
        outline = {std::min(outline.x1, p.x()), std::min(outline.y1, p.y()), std::max(outline.x2, p.x()),
                   std::max(outline.y2, p.y())};
      }
    }
    EXPECT_LT((detections[0].detection.box.edges() - outline.edges()).cwiseAbs().maxCoeff(), 0.15);
  }
}

TEST(Detector, truncated_boxes_stay_inside_the_image) {
  const SimulatedSequence sequence = simulate_fr2({{"scene.layout", "office"}, {"trajectory.duration_s", "20"}});
  const Camera& camera = sequence.camera;
  int cut = 0;
  for (const auto& frame : sequence.detections) {
    for (const SimulatedDetection& d : frame) {
      const Box& b = d.detection.box;
      EXPECT_TRUE(b.is_valid());
      EXPECT_TRUE(b.x1 >= 0.0 && b.y1 >= 0.0 && b.x2 <= camera.width && b.y2 <= camera.height);
      cut += truncated_sides(b, camera.width, camera.height, 0.0) != 0 ? 1 : 0;
    }
  }
  EXPECT_GT(cut, 50);
}

TEST(Detector, nearer_objects_hide_farther_ones) {
  const SE3 T = looking_along_x({0.0, 0.0, 1.2});
  const SceneObject front = turned_object(kTv, {1.5, 0.0, 1.2}, {0.1, 0.3, 0.3});
  const Camera camera = pinhole();
  DetectorOptions options = perfect_detector();
  options.min_visible = 0.4;
  const auto hidden =
      detect_once(scene_of({front, turned_object(kCup, {3.0, 0.0, 1.2}, {0.1, 0.1, 0.1})}), camera, options, T);
  ASSERT_EQ(hidden.size(), 1u);
  EXPECT_EQ(hidden[0].detection.class_id, kTv);

  // To the left of the view's middle is +y; the right part of the far object is hidden.
  const Scene half = scene_of({front, turned_object(kTv, {3.0, 0.7, 1.2}, {0.3, 0.3, 0.3})});
  const auto views = SceneProjector(half, camera).project(T);
  ASSERT_TRUE(views[1]);
  EXPECT_GT(views[1]->visible, 0.4);
  EXPECT_LT(views[1]->visible, 0.95);
  EXPECT_DOUBLE_EQ(views[1]->box.x1, views[1]->whole.x1);
  EXPECT_LT(views[1]->box.x2, views[1]->whole.x2 - 5.0);
  EXPECT_DOUBLE_EQ(views[0]->visible, 1.0);
}

TEST(Detector, table_tops_hide_what_is_below) {
  Scene scene = scene_of({turned_object(kCup, {3.0, 0.0, 0.4}, {0.1, 0.1, 0.1})});
  const SE3 T = looking_along_x({0.0, 0.0, 1.6});
  ASSERT_TRUE(SceneProjector(scene, pinhole()).project(T)[0]);
  EXPECT_DOUBLE_EQ(SceneProjector(scene, pinhole()).project(T)[0]->visible, 1.0);
  scene.desks[0].T_world_desk.t = Vec3(2.3, 0.0, 0.74);
  EXPECT_DOUBLE_EQ(SceneProjector(scene, pinhole()).project(T)[0]->visible, 0.0);
}

struct Counts {
  double frames = 0.0, boxes = 0.0, wrong = 0.0, false_boxes = 0.0;
};

Counts count(const Scene& scene, const DetectorOptions& options, int frames, std::uint64_t seed) {
  DetectorModel model(scene, pinhole(), coco(), options, 30.0, seed);
  Counts counts;
  for (int i = 0; i < frames; ++i) {
    ++counts.frames;
    for (const SimulatedDetection& d : model.detect(looking_along_x({0.0, 0.0, 1.2}))) {
      if (d.object < 0) {
        ++counts.false_boxes;
        continue;
      }
      ++counts.boxes;
      if (d.detection.class_id != scene.objects[static_cast<std::size_t>(d.object)].class_id) ++counts.wrong;
      EXPECT_GE(d.detection.score, options.min_score);
      EXPECT_LE(d.detection.score, 1.0);
    }
  }
  return counts;
}

TEST(Detector, rates_are_those_asked_for) {
  const Scene scene = wall(kCup, 10, 6);
  DetectorOptions options = perfect_detector();
  options.miss_rate = 0.3;
  options.mislabel_rate = 0.1;
  options.false_rate = 0.7;
  constexpr int kFrames = 2000;
  const double objects = 60.0 * kFrames;
  const Counts independent = count(scene, options, kFrames, 3);
  // Five standard deviations of independent draws.
  EXPECT_NEAR(independent.boxes / objects, 0.7, 5.0 * std::sqrt(0.21 / objects));
  EXPECT_NEAR(independent.wrong / independent.boxes, 0.1, 5.0 * std::sqrt(0.09 / independent.boxes));
  EXPECT_NEAR(independent.false_boxes / kFrames, 0.7, 5.0 * std::sqrt(0.7 / kFrames));

  // Lasting errors: the same shares, from as many independent draws as there are memory times.
  options.persistence_s = 0.4;
  const double draws = objects / (2.0 * 0.4 * 30.0);
  const Counts lasting = count(scene, options, kFrames, 3);
  EXPECT_NEAR(lasting.boxes / objects, 0.7, 5.0 * std::sqrt(0.21 / draws));
  EXPECT_NEAR(lasting.wrong / lasting.boxes, 0.1, 5.0 * std::sqrt(0.09 / draws));
  EXPECT_NEAR(lasting.false_boxes / kFrames, 0.7, 5.0 * std::sqrt(0.7 * 4.0 / kFrames));
}

TEST(Detector, misses_last) {
  DetectorOptions options = perfect_detector();
  options.miss_rate = 0.3;
  options.persistence_s = 0.4;
  const Scene scene = wall(kCup, 10, 6);
  DetectorModel model(scene, pinhole(), coco(), options, 30.0, 5);
  std::vector<bool> before(scene.objects.size(), true);
  double missed = 0.0, missed_again = 0.0;
  for (int i = 0; i < 1000; ++i) {
    std::vector<bool> seen(scene.objects.size(), false);
    for (const SimulatedDetection& d : model.detect(looking_along_x({0.0, 0.0, 1.2})))
      seen[static_cast<std::size_t>(d.object)] = true;
    for (std::size_t k = 0; k < seen.size(); ++k) {
      missed += before[k] ? 0.0 : 1.0;
      missed_again += !before[k] && !seen[k] ? 1.0 : 0.0;
    }
    before = seen;
  }
  EXPECT_GT(missed_again / missed, 0.75);
}

TEST(Detector, small_objects_are_missed_more) {
  DetectorOptions options = perfect_detector();
  options.small_box_px = 27.8;  // 2 * 521 px * 0.08 m / 3 m
  const Counts counts = count(wall(kCup, 10, 6), options, 500, 9);
  EXPECT_NEAR(counts.boxes / (60.0 * 500.0), 0.5, 0.05);
}

TEST(Detector, wrong_labels_stay_in_the_group) {
  DetectorOptions options = perfect_detector();
  options.mislabel_rate = 1.0;
  const ClassTable classes = coco();
  for (const SimulatedDetection& d :
       detect_once(wall(kVase, 10, 6), pinhole(), options, looking_along_x({0.0, 0.0, 1.2}))) {
    EXPECT_NE(d.detection.class_id, kVase);
    EXPECT_TRUE(classes.confusable(d.detection.class_id, kVase)) << d.detection.class_id;
  }
}

TEST(Detector, edges_scatter_as_asked) {
  DetectorOptions options = perfect_detector();
  options.jitter_px = 2.0;
  const Scene scene = wall(kCup, 10, 6);
  const Camera camera = pinhole();
  const SceneProjector projector(scene, camera);
  DetectorModel model(scene, camera, coco(), options, 30.0, 11);
  double sum = 0.0, squares = 0.0, n = 0.0;
  for (int i = 0; i < 200; ++i) {
    for (const SimulatedDetection& d : model.detect(looking_along_x({0.0, 0.0, 1.2}))) {
      const auto truth = projector.raw_box(scene.objects[static_cast<std::size_t>(d.object)].ellipsoid,
                                           looking_along_x({0.0, 0.0, 1.2}));
      const Vec4 e = d.detection.box.edges() - truth->edges();
      sum += e.sum();
      squares += e.squaredNorm();
      n += 4.0;
    }
  }
  EXPECT_NEAR(sum / n, 0.0, 5.0 * 2.0 / std::sqrt(n));
  EXPECT_NEAR(std::sqrt(squares / n), 2.0, 5.0 * 2.0 / std::sqrt(2.0 * n));
}

}  // namespace
}  // namespace semantic_topo_loop::core
