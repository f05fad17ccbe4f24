#include "semantic_topo_loop/types/map_unit.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <string>
#include <vector>

namespace semantic_topo_loop::core {
namespace {

constexpr int kClasses = 12;

ClassTable table() {
  std::vector<ObjectClass> classes;
  for (int id = 0; id < kClasses; ++id) {
    classes.push_back({id, "class " + std::to_string(id), ClassRole::kMovable, "", 0.1 * (id + 1)});
  }
  return *ClassTable::create(std::move(classes));
}

Landmark ball(int class_id, double diameter) {
  Landmark landmark;
  landmark.class_id = class_id;
  landmark.state = LandmarkState::kConfirmed;
  landmark.ellipsoid = Ellipsoid{SE3(), Vec3::Constant(0.5 * diameter)};
  return landmark;
}

TEST(MapUnit, OfObjectsOfTypicalSizesIsExact) {
  std::vector<Landmark> landmarks;
  for (int id = 0; id < kClasses; ++id) landmarks.push_back(ball(id, 0.1 * (id + 1) / 2.5));
  const std::optional<MapUnit> unit = map_unit(landmarks, table());
  ASSERT_TRUE(unit);
  EXPECT_NEAR(unit->metres, 2.5, 1e-9);
  EXPECT_EQ(unit->objects, kClasses);
  EXPECT_EQ(unit->classes, kClasses);
}

TEST(MapUnit, ErrorsAreWithinTheirSigma) {
  std::mt19937_64 engine(1);
  std::normal_distribution<double> normal;
  constexpr int kMaps = 200;
  double squares = 0.0;
  for (int map = 0; map < kMaps; ++map) {
    std::vector<Landmark> landmarks;
    const double of_table = 0.1 * normal(engine);
    for (int id = 0; id < kClasses; ++id) {
      const double of_class = of_table + 0.28 * normal(engine);
      for (int k = 0; k <= id % 3; ++k) {
        landmarks.push_back(ball(id, 0.1 * (id + 1) * std::exp(of_class + 0.2 * normal(engine))));
      }
    }
    const std::optional<MapUnit> unit = map_unit(landmarks, table());
    const double sigmas = std::log(unit->metres) / unit->sigma;
    squares += sigmas * sigmas / kMaps;
  }
  EXPECT_GT(squares, 0.5);
  EXPECT_LT(squares, 1.5);
}

TEST(MapUnit, OneClassOfAnotherSizeIsOutvoted) {
  std::vector<Landmark> landmarks;
  for (int id = 0; id < kClasses; ++id) landmarks.push_back(ball(id, 0.1 * (id + 1) * (id == 3 ? 20.0 : 1.0)));
  EXPECT_NEAR(map_unit(landmarks, table())->metres, 1.0, 0.05);
}

TEST(MapUnit, FewClassesCandidatesAndUnknownOnesTellNothing) {
  std::vector<Landmark> landmarks{ball(0, 0.1), ball(0, 0.1), ball(1, 0.2), ball(99, 0.3)};
  EXPECT_FALSE(map_unit(landmarks, table()));
  landmarks.push_back(ball(2, 0.3));
  EXPECT_TRUE(map_unit(landmarks, table()));
  landmarks.back().state = LandmarkState::kCandidate;
  EXPECT_FALSE(map_unit(landmarks, table()));
  landmarks.back() = ball(2, 0.3);
  landmarks.back().ellipsoid.reset();
  EXPECT_FALSE(map_unit(landmarks, table()));
}

}  // namespace
}  // namespace semantic_topo_loop::core
