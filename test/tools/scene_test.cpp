#include "tools/simulation/scene.h"

#include <algorithm>
#include <set>

#include "support/test_fixtures.h"

namespace semantic_topo_loop::core {
namespace {

using simulation_test::coco;

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

INSTANTIATE_TEST_SUITE_P(Layouts, SceneTest, ::testing::Values("desk", "office"));

TEST(Scene, office_has_the_desks_asked_for) {
  SceneOptions options;
  options.layout = "office";
  options.desks = 5;
  EXPECT_EQ(make_scene(options, 1).desks.size(), 5u);
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

}  // namespace
}  // namespace semantic_topo_loop::core
