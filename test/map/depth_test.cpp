#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "geometry/depth_points.h"
#include "map/landmark_fitter.h"
#include "map/quadric_fit.h"
#include "semantic_topo_loop/geometry/quadric.h"
#include "support/depth_scene.h"
#include "support/look_at.h"
#include "support/mapper_fixture.h"

namespace semantic_topo_loop::core {
namespace {

using testing::DepthScene;
using testing::look_at;
using testing::on_table;

const Camera& kCamera = testing::kMapperCamera;
const Ellipsoid kCup = on_table(0.05, -0.1, Vec3(0.045, 0.045, 0.06));
const Ellipsoid kKeyboard = on_table(0.0, 0.0, Vec3(0.08, 0.22, 0.018), 0.3);
const Ellipsoid kBottle = on_table(-0.1, 0.15, Vec3(0.035, 0.035, 0.12));

SE3 from_side(double angle_deg) {
  const double a = radians(angle_deg);
  return look_at(Vec3(1.2 * std::cos(a), 1.2 * std::sin(a), 0.8), Vec3(0.0, 0.0, 0.05));
}

Box box_of(const Ellipsoid& ellipsoid, const SE3& pose) {
  return *project_box(ellipsoid, projection_matrix(kCamera, pose));
}

BoxView view_of(const Ellipsoid& ellipsoid, const SE3& pose, const DepthScene& scene) {
  const Box box = box_of(ellipsoid, pose);
  const FramePoints points(scene.look(kCamera, pose), kCamera);
  const std::vector<Placement> placements = place(points, box);
  return {pose, box, 0, placements.size() == 1 ? placements.front().center.z() : 0.0};
}

TEST(FramePoints, FindThePointsInABoxAsALookAtAllOfThemDoes) {
  std::vector<Vec3> all = DepthScene{{kCup, kBottle}}.look(kCamera, from_side(20.0));
  const double nan = std::numeric_limits<double>::quiet_NaN();
  all.insert(all.begin() + 100, {Vec3(nan, 0.0, 1.0), Vec3(0.0, 0.0, -1.0), Vec3(0.0, 0.0, 0.0), Vec3(9.0, 9.0, 0.01)});
  const FramePoints points(all, kCamera);
  for (const Box& box : {Box{100.0, 50.0, 300.0, 200.0}, Box{-50.0, -50.0, 20.0, 700.0},
                         Box{310.5, 200.0, 311.5, 480.0}, Box{0.0, 0.0, 1e9, 1e9}}) {
    std::size_t inside = 0;
    for (const Vec3& p : all) {
      const double u = 520.0 * p.x() / p.z() + 320.0, v = 520.0 * p.y() / p.z() + 240.0;
      inside += p.z() > 0.0 && u >= box.x1 && u <= box.x2 && v >= box.y1 && v <= box.y2 ? 1 : 0;
    }
    EXPECT_EQ(points.in(box, all.size()).size(), inside);
  }
  const std::size_t thinned = points.in({0.0, 0.0, 640.0, 480.0}, 300).size();
  EXPECT_GT(thinned, 200U);
  EXPECT_LE(thinned, 300U);
  EXPECT_TRUE(points.in({10.0, 10.0, 5.0, 20.0}, 300).empty());
  EXPECT_TRUE(FramePoints({}, kCamera).in({0.0, 0.0, 640.0, 480.0}, 300).empty());
}

TEST(DominantPlane, IsTheTableUnderThings) {
  const SE3 pose = from_side(60.0);
  const std::vector<Vec3> points = DepthScene{{kCup, kKeyboard}}.look(kCamera, pose);
  const std::optional<Plane> plane = dominant_plane(points, 50, 0.3);
  ASSERT_TRUE(plane);
  EXPECT_GT((pose.q * plane->normal).z(), std::cos(radians(1.0))) << "towards the camera, so upwards";
  EXPECT_NEAR(plane->offset, 0.8, 0.01);
  EXPECT_FALSE(dominant_plane({}, 50, 0.3));
  EXPECT_FALSE(dominant_plane(std::vector<Vec3>(20, Vec3(0.0, 0.0, 1.0)), 50, 0.3)) << "one point many times";
}

TEST(Placement, IsOnTheObjectWhereItHasHolesAndWhereTheTableShowsBehindIt) {
  const Ellipsoid screen = on_table(-0.3, 0.0, Vec3(0.03, 0.3, 0.2));
  const SE3 pose = from_side(0.0);
  const Box box = box_of(screen, pose);
  std::vector<Vec3> rim;  // a black screen gives no depth but at its rim, and through gaps what is far behind
  for (const Vec3& p : DepthScene{{screen}}.look(kCamera, pose)) {
    const Vec2 offset = (kCamera.pixel(p) - box.center()).cwiseQuotient(Vec2(box.width(), box.height()));
    if (offset.cwiseAbs().maxCoeff() > 0.33) rim.push_back(p);
  }
  const std::vector<Placement> placements = place(FramePoints(rim, kCamera), box);
  ASSERT_EQ(placements.size(), 1U);
  EXPECT_LT((pose * placements.front().center - screen.center()).norm(), 0.08);
  EXPECT_NEAR(placements.front().size_m, 0.6, 0.06);
}

/// Boxes of real detectors are larger than the object: what is left must be the object all the same.
TEST(ObjectLayers, AreThoseOfTheObjectAndNotOfTheTableBehindIt) {
  const DepthScene scene{{kCup, kBottle}};
  for (const double angle : {0.0, 70.0, 200.0}) {
    const SE3 pose = from_side(angle);
    const FramePoints frame(scene.look(kCamera, pose), kCamera);
    Box box = box_of(kCup, pose);
    const double margin = 0.15 * box.size();
    box = {box.x1 - margin, box.y1 - margin, box.x2 + margin, box.y2 + margin};
    const std::vector<std::vector<Vec3>> layers = object_layers(frame, box);
    ASSERT_EQ(layers.size(), 1U);
    const std::vector<Vec3>& points = layers.front();
    ASSERT_GT(points.size(), 15U);
    std::size_t on_cup = 0;
    for (const Vec3& p : points) {
      const Vec3 q = kCup.T_world_quadric.inverse() * (pose * p);
      on_cup += std::abs(q.cwiseQuotient(kCup.semi_axes).norm() - 1.0) < 0.3 ? 1 : 0;
    }
    EXPECT_GT(static_cast<double>(on_cup), 0.9 * static_cast<double>(points.size())) << angle;
  }
}

TEST(ObjectLayers, OfASheetOnATableAreItsPartOfTheTable) {
  const SE3 pose = from_side(0.0);
  const Ellipsoid sheet = on_table(0.0, 0.0, Vec3(0.10, 0.15, 0.001));
  const FramePoints frame(DepthScene{{sheet}}.look(kCamera, pose), kCamera);
  const std::vector<std::vector<Vec3>> layers = object_layers(frame, box_of(sheet, pose));
  ASSERT_EQ(layers.size(), 1U);
  ASSERT_GT(layers.front().size(), 30U);
  for (const Vec3& p : layers.front()) EXPECT_NEAR((pose * p).z(), 0.0, 0.02);
}

TEST(ObjectLayers, AreTwoOfAChairBehindTheTable) {
  const Ellipsoid chair{SE3(Quaternion::Identity(), Vec3(-1.8, 0.0, -0.3)), Vec3(0.25, 0.25, 0.5)};
  const SE3 pose = look_at(Vec3(1.2, 0.0, 0.8), Vec3(-1.0, 0.0, 0.1));
  const FramePoints frame(DepthScene{{chair}}.look(kCamera, pose), kCamera);
  const std::vector<Placement> placements = place(frame, box_of(chair, pose));
  ASSERT_EQ(placements.size(), 2U);
  EXPECT_LT((pose * placements[0].center).x(), -0.2) << "the end of the table";
  EXPECT_GT((pose * placements[0].center).x(), -1.1);
  EXPECT_LT((pose * placements[1].center - chair.center()).norm(), 0.3);
  EXPECT_GT(placements[1].size_m, placements[0].size_m);
}

TEST(ObjectLayers, IsOneOfAThingWithHolesThatEndsWithItsBox) {
  std::vector<Vec3> points;  // the left half of the box, and a wall behind all of it
  const Box box{280.0, 200.0, 360.0, 280.0};
  for (double v = 150.0; v < 330.0; v += 4.0) {
    for (double u = 230.0; u < 410.0; u += 4.0) {
      const bool is_thing = u > box.x1 && u < box.center().x() && v > box.y1 && v < box.y2;
      points.push_back((is_thing ? 1.0 : 3.0) * kCamera.ray(Vec2(u, v)));
    }
  }
  const std::vector<Placement> placements = place(FramePoints(points, kCamera), box);
  ASSERT_EQ(placements.size(), 1U);
  EXPECT_NEAR(placements.front().center.z(), 1.0, 1e-6);
}

TEST(HiddenSides, NoneOfWhatStandsOnTheTable) {
  for (const Ellipsoid& object : {kCup, kKeyboard, kBottle}) {
    for (const double angle : {0.0, 70.0, 140.0, 200.0, 300.0}) {
      const SE3 pose = from_side(angle);
      const FramePoints frame(DepthScene{{object}}.look(kCamera, pose), kCamera);
      EXPECT_EQ(hidden_sides(frame, box_of(object, pose)), 0) << angle;
    }
  }
}

TEST(HiddenSides, TheLowerOneOfAChairBehindTheTable) {
  const Ellipsoid chair{SE3(Quaternion::Identity(), Vec3(-1.4, 0.0, 0.0)), Vec3(0.25, 0.25, 0.5)};
  const SE3 pose = look_at(Vec3(1.2, 0.0, 0.8), Vec3(-1.0, 0.0, 0.1));
  const FramePoints frame(DepthScene{{chair}}.look(kCamera, pose), kCamera);
  Box box = box_of(chair, pose);
  const Vec3 edge = pose.inverse() * Vec3(-1.0, 0.0, 0.0);
  box.y2 = kCamera.fy * edge.y() / edge.z() + kCamera.cy;
  EXPECT_EQ(hidden_sides(frame, box), kBottom);
}

TEST(HiddenSides, TheOneAtWhichSomethingStandsInFront) {
  const Ellipsoid screen = on_table(-0.5, 0.0, Vec3(0.05, 0.4, 0.25)),
                  cylinder = on_table(0.0, 0.35, Vec3(0.1, 0.2, 0.4));
  const SE3 pose = look_at(Vec3(1.2, 0.0, 0.5), Vec3(0.0, 0.0, 0.2));
  const FramePoints frame(DepthScene{{screen, cylinder}}.look(kCamera, pose), kCamera);
  Box box = box_of(screen, pose);
  const Box front = box_of(cylinder, pose);
  const bool is_right = front.center().x() > box.center().x();
  (is_right ? box.x2 : box.x1) = is_right ? front.x1 : front.x2;
  EXPECT_EQ(hidden_sides(frame, box) & (kLeft | kRight), is_right ? kRight : kLeft);
}

TEST(HiddenSides, BadInputHidesNothing) {
  const FramePoints empty({}, kCamera);
  EXPECT_EQ(hidden_sides(empty, {100.0, 100.0, 200.0, 200.0}), 0);
  EXPECT_EQ(hidden_sides(empty, {200.0, 100.0, 100.0, 200.0}), 0);
  const FramePoints same(std::vector<Vec3>(50, Vec3(0.0, 0.0, 1.0)), kCamera);
  EXPECT_EQ(hidden_sides(same, {300.0, 220.0, 340.0, 260.0}), 0) << "one point many times";
}

TEST(ObjectLayers, BadInputGivesNone) {
  const FramePoints empty({}, kCamera);
  EXPECT_TRUE(object_layers(empty, {100.0, 100.0, 200.0, 200.0}).empty());
  const FramePoints same(std::vector<Vec3>(50, Vec3(0.0, 0.0, 1.0)), kCamera);
  EXPECT_EQ(object_layers(same, {300.0, 220.0, 340.0, 260.0}).size(), 1U) << "no crash on one point many times";
  EXPECT_TRUE(object_layers(same, {340.0, 220.0, 300.0, 260.0}).empty());
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(object_layers(same, {nan, 220.0, 340.0, 260.0}).empty());
  EXPECT_TRUE(place(empty, {100.0, 100.0, 200.0, 200.0}).empty());
}

TEST(DepthFit, OneViewGivesTheCentreToAThirdOfTheRadius) {
  for (const Ellipsoid& object : {kCup, kBottle, kKeyboard}) {
    const BoxView view = view_of(object, from_side(30.0), DepthScene{{object}});
    const std::optional<Ellipsoid> start = initialise_from_depth(kCamera, view, 2.0 * object.radius());
    ASSERT_TRUE(start);
    const std::optional<QuadricFit> fit = refine_quadric(kCamera, {view}, *start);
    ASSERT_TRUE(fit);
    EXPECT_LT((fit->ellipsoid.center() - object.center()).norm(), 0.015 + 0.33 * object.radius());
    EXPECT_GT(fit->mean_iou, 0.8);
    EXPECT_LT((fit->ellipsoid.center() - object.center()).norm(), 3.0 * std::sqrt(fit->center_covariance.trace()));
  }
}

TEST(DepthFit, WithoutDepthThereIsNoStartAndACutBoxGivesWhatIsSeen) {
  BoxView view = view_of(kCup, from_side(30.0), DepthScene{{kCup}});
  const std::optional<Ellipsoid> whole = initialise_from_depth(kCamera, view, 0.1);
  view.box.x1 = view.box.center().x();
  view.truncated = kLeft;
  const std::optional<Ellipsoid> half = initialise_from_depth(kCamera, view, 0.1);
  ASSERT_TRUE(whole && half);
  EXPECT_NEAR(half->semi_axes.x(), 0.5 * whole->semi_axes.x(), 1e-6);
  view.near_m = 0.0;
  EXPECT_FALSE(initialise_from_depth(kCamera, view, 0.1));
}

/// The right half of a screen, then all of it: where the border cut the box the screen went on.
TEST(DepthFit, WhatTheBorderCutsReachesAtLeastToItAndGrows) {
  const Ellipsoid screen = on_table(-0.3, 0.0, Vec3(0.03, 0.3, 0.2));
  const DepthScene scene{{screen}};
  std::vector<BoxView> views;
  for (int i = 0; i < 6; ++i) {
    BoxView view = view_of(screen, from_side(2.0 * i), scene);
    view.box.x1 = view.box.center().x();
    view.truncated = kLeft;
    views.push_back(view);
  }
  const std::optional<Ellipsoid> start = initialise_from_depth(kCamera, views.back(), 0.0);
  ASSERT_TRUE(start);
  const std::optional<QuadricFit> half = refine_quadric(kCamera, views, *start);
  ASSERT_TRUE(half);
  for (const BoxView& view : views) {
    const Box box = *project_box(half->ellipsoid, projection_matrix(kCamera, view.T_world_camera));
    EXPECT_LT(box.x1, view.box.x1 + 10.0);
  }
  for (int i = 0; i < 6; ++i) views.push_back(view_of(screen, from_side(2.0 * i), scene));
  const std::optional<QuadricFit> whole = refine_quadric(kCamera, views, half->ellipsoid);
  ASSERT_TRUE(whole);
  EXPECT_LT((whole->ellipsoid.center() - screen.center()).norm(), 0.03);
  EXPECT_NEAR(whole->ellipsoid.semi_axes.maxCoeff(), 0.3, 0.03);
}

/// Boxes from a narrow angle leave the distance open; depth closes it.
TEST(DepthFit, DepthPinsTheDistanceThatBoxesLeaveOpen) {
  const DepthScene scene{{kBottle}};
  std::vector<BoxView> with_depth, without;
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal(0.0, 2.0);
  for (int i = 0; i < 8; ++i) {
    BoxView view = view_of(kBottle, from_side(30.0 + i), scene);
    for (double* edge : {&view.box.x1, &view.box.y1, &view.box.x2, &view.box.y2}) *edge += normal(random);
    with_depth.push_back(view);
    view.near_m = 0.0;
    without.push_back(view);
  }
  const std::optional<Ellipsoid> start = initialise_from_depth(kCamera, with_depth.back(), 0.0);
  ASSERT_TRUE(start);
  const std::optional<QuadricFit> depth = refine_quadric(kCamera, with_depth, *start);
  const std::optional<QuadricFit> boxes = refine_quadric(kCamera, without, *start);
  ASSERT_TRUE(depth && boxes);
  EXPECT_LT((depth->ellipsoid.center() - kBottle.center()).norm(), 0.035);
  EXPECT_LT(depth->center_covariance.trace(), 0.5 * boxes->center_covariance.trace());
}

/// Half of the views took a wall far behind for the object.
TEST(DepthFit, ViewsWithTheDepthOfSomethingElseDoNotMoveIt) {
  const DepthScene scene{{kCup}};
  std::vector<BoxView> views;
  for (int i = 0; i < 12; ++i) {
    views.push_back(view_of(kCup, from_side(10.0 * i), scene));
    if (i % 2 == 0) views.back().near_m *= 2.0;
  }
  const std::optional<QuadricFit> fit =
      refine_quadric(kCamera, views, Ellipsoid{kCup.T_world_quadric, Vec3::Constant(0.05)});
  ASSERT_TRUE(fit);
  EXPECT_LT((fit->ellipsoid.center() - kCup.center()).norm(), 0.01);
}

class DepthMapperTest : public testing::MapperFixture {
 protected:
  DepthMapperTest()
      : MapperFixture({{41, "cup", ClassRole::kMovable, "", 0.1},
                       {60, "dining table", ClassRole::kStatic, "", 1.2},
                       {62, "tv", ClassRole::kStatic, "", 0.4}}) {}

  void step(const SE3& pose, const std::vector<Seen>& seen, const DepthScene& scene) {
    MapperFixture::step(pose, seen, std::make_shared<const std::vector<Vec3>>(scene.look(kCamera, pose)));
  }
};

TEST_F(DepthMapperTest, OneFrameGivesAnEllipsoidAndMoreMakeItExact) {
  const DepthScene scene{{kCup}};
  step(from_side(0.0), {{0, 41, kCup}}, scene);
  ASSERT_TRUE(find(0)->ellipsoid);
  EXPECT_EQ(find(0)->state, LandmarkState::kCandidate);
  EXPECT_LT((find(0)->ellipsoid->center() - kCup.center()).norm(), 0.04);
  for (int i = 1; i < 60; ++i) step(from_side(1.5 * i), {{0, 41, kCup}}, scene);
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed);
  // The cup is 1.5 cm thicker than depth is believed to hide.
  EXPECT_LT((find(0)->ellipsoid->center() - kCup.center()).norm(), 0.018);
}

TEST_F(DepthMapperTest, ARefusedFitWaitsForMoreViews) {
  QuadricMapperOptions options;
  options.min_fit_iou = 1.0;
  mapper_ = QuadricMapper(options, classes_);
  const DepthScene scene{{kCup}};
  for (int i = 0; i < 5; ++i) {
    step(from_side(1.5 * i), {{0, 41, kCup}}, scene);
    EXPECT_FALSE(find(0)->ellipsoid);
    EXPECT_EQ(mapper_.state().landmarks.at(0).next_fit_at, 6) << "five after the first, which has depth";
  }
}

TEST_F(DepthMapperTest, OneThingUnderTwoNamesBecomesOneWhereDepthPlacesIt) {
  const DepthScene scene{{kCup}};
  for (int i = 0; i < 60; ++i) step(from_side(1.5 * i), {i % 3 == 0 ? Seen{1, 62, kCup} : Seen{0, 41, kCup}}, scene);
  ASSERT_NE(find(0), nullptr);
  EXPECT_EQ(find(1), nullptr);
  EXPECT_EQ(find(0)->observations, 60);
  ASSERT_EQ(find(0)->class_counts.size(), 2U);
  EXPECT_EQ(find(0)->class_counts[0].count, 40) << "by its first name";
  EXPECT_EQ(find(0)->class_counts[1].count, 20);
}

TEST_F(DepthMapperTest, DepthConfirmsFromOneSideAndLowScoresTakeLonger) {
  const DepthScene scene{{kCup, kBottle}};
  int sure = 0, unsure = 0;
  for (int i = 0; i < 120; ++i) {
    step(from_side(0.01 * i), {{0, 41, kCup, 0, 1.0}, {1, 62, kBottle, 0, 0.25}}, scene);
    sure += find(0)->state == LandmarkState::kConfirmed ? 1 : 0;
    unsure += find(1)->state == LandmarkState::kConfirmed ? 1 : 0;
  }
  EXPECT_LT(find(0)->baseline_deg, 3.0);
  EXPECT_GT(sure, 75);
  EXPECT_GT(unsure, 30);
  EXPECT_NEAR(120 - unsure, 2 * (120 - sure), 10);
}

TEST_F(DepthMapperTest, WhatNoImageShowsTheEndOfIsNotConfirmed) {
  const DepthScene scene{{kCup, kBottle}};
  for (int i = 0; i < 90; ++i) {
    const auto cut = static_cast<std::uint8_t>(i % 2 == 0 ? kLeft : kTop);
    step(from_side(i), {{0, 41, kCup, cut}, {1, 62, kBottle, kLeft}}, scene);
  }
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed) << "every image cuts it, on one side or another";
  EXPECT_EQ(find(1)->state, LandmarkState::kCandidate);
}

TEST_F(DepthMapperTest, WhatDepthSeesThroughIsRetiredAndWhatItSeesInFrontHidesIt) {
  const Ellipsoid tv = on_table(-0.3, 0.2, Vec3(0.06, 0.2, 0.18));
  const DepthScene both{{kCup, tv}};
  for (int i = 0; i < 60; ++i) step(from_side(1.5 * i), {{0, 41, kCup}, {1, 62, tv}}, both);
  ASSERT_EQ(find(0)->state, LandmarkState::kConfirmed);
  ASSERT_EQ(find(1)->state, LandmarkState::kConfirmed);
  // A box stands before the cup: the detector misses it, and rightly.
  for (int i = 0; i < 60; ++i) {
    DepthScene hidden = both;
    const SE3 pose = from_side(1.5 * i);
    hidden.objects.push_back({SE3(Quaternion::Identity(), 0.5 * (pose.t + kCup.center())), Vec3::Constant(0.12)});
    step(pose, {{1, 62, tv}}, hidden);
  }
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed);
  // The cup is carried away, the screen stays.
  const DepthScene without_cup{{tv}};
  for (int i = 0; i < 85; ++i) step(from_side(-1.5 * (i + 4)), {{1, 62, tv}}, without_cup);
  EXPECT_EQ(find(0)->state, LandmarkState::kRetired) << "within 2.8 s, from where it had never been seen";
  EXPECT_EQ(find(1)->state, LandmarkState::kConfirmed);
}

TEST_F(DepthMapperTest, ATableHidesNothingOfWhatDepthShowsOnIt) {
  const Ellipsoid table{SE3(Quaternion::Identity(), Vec3(0.2, 0.0, -0.02)), Vec3(0.6, 0.6, 0.02)};
  const Ellipsoid cup = on_table(-0.05, 0.0, Vec3(0.045, 0.045, 0.06));
  for (int i = 0; i < 60; ++i) step(from_side(0.5 * i), {{0, 41, cup}, {1, 60, table}}, DepthScene{{cup}});
  ASSERT_EQ(find(0)->state, LandmarkState::kConfirmed);
  ASSERT_TRUE(find(1)->ellipsoid);
  for (int i = 0; i < 85; ++i) step(from_side(0.5 * (i % 60)), {{1, 60, table}}, {});
  EXPECT_EQ(find(0)->state, LandmarkState::kRetired) << "carried away";
}

TEST_F(DepthMapperTest, DepthAloneTellsWhereNothingIsBoxed) {
  const DepthScene scene{{kCup}};
  for (int i = 0; i < 60; ++i) step(from_side(1.5 * i), {{0, 41, kCup}}, scene);
  for (int i = 0; i < 200; ++i) step(from_side(1.5 * (i % 60)), {}, scene);
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed) << "the detector fails";
  for (int i = 0; i < 85; ++i) step(from_side(1.5 * (i % 60)), {}, {});
  EXPECT_EQ(find(0)->state, LandmarkState::kRetired) << "the only thing on the table is gone";
}

TEST_F(DepthMapperTest, ADetectorThatMissesWhatDepthStillShowsRetiresNothing) {
  const Ellipsoid tv = on_table(-0.3, 0.2, Vec3(0.06, 0.2, 0.18));
  const DepthScene scene{{kCup, tv}};
  for (int i = 0; i < 60; ++i) step(from_side(1.5 * i), {{0, 41, kCup}, {1, 62, tv}}, scene);
  for (int i = 0; i < 60; ++i) step(from_side(1.5 * i), {{1, 62, tv}}, scene);
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed);
}

TEST_F(DepthMapperTest, WhatWasFoundFromNearbyAloneIsNotMissedFromAfar) {
  const Ellipsoid tv = on_table(-0.3, 0.2, Vec3(0.06, 0.2, 0.18));
  const DepthScene scene{{kCup, tv}};
  for (int i = 0; i < 60; ++i) step(from_side(1.5 * i), {{0, 41, kCup}, {1, 62, tv}}, scene);
  ASSERT_EQ(find(0)->state, LandmarkState::kConfirmed);
  for (int i = 0; i < 600; ++i) {
    const double a = radians(0.15 * i);
    const SE3 from_afar = look_at(Vec3(2.6 * std::cos(a), 2.6 * std::sin(a), 1.5), Vec3::Zero());
    step(from_afar, {{1, 62, tv}}, scene);
  }
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed) << "the detector is too small for a cup three metres away";
}

TEST_F(DepthMapperTest, WhatADetectorHardlyFindsAgainIsItsMistake) {
  const Ellipsoid tv = on_table(-0.3, 0.2, Vec3(0.06, 0.2, 0.18));
  const DepthScene scene{{kCup, tv, kBottle}};
  for (int i = 0; i < 360; ++i) {
    std::vector<Seen> seen{{2, 62, tv}};
    if (i % 2 == 0) seen.push_back({0, 41, kCup});
    if (i % 6 == 0) seen.push_back({1, 41, kBottle});
    step(from_side(0.1 * i), seen, scene);
  }
  ASSERT_NE(find(1), nullptr);
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed);
  EXPECT_EQ(find(1)->state, LandmarkState::kCandidate) << "boxed for 2 s, but once in six views from there";
}

TEST(LifeCycle, AFewMissesAreNoMistakeOfTheDetector) {
  MappedLandmark landmark;
  landmark.state.ellipsoid = kCup;
  landmark.state.observations = 100;
  landmark.state.mean_iou = 0.9;
  Sightings& sightings = landmark.sightings;
  sightings.seen_s = sightings.placed_s = sightings.whole_s = 3.0;
  sightings.expected_s = 1.3;
  sightings.familiar_seen_s = 0.1;
  sightings.familiar_missed_s = 0.5;
  EXPECT_EQ(life_cycle_state(landmark, {}, false), LandmarkState::kConfirmed);
  sightings.familiar_seen_s = 0.4;
  sightings.familiar_missed_s = 2.0;
  EXPECT_EQ(life_cycle_state(landmark, {}, false), LandmarkState::kCandidate) << "the same share of more";
}

TEST(LifeCycle, WhatShowsItsInsideHasHolesUnlessItIsHollow) {
  MappedLandmark landmark;
  landmark.state.ellipsoid = kCup;
  Sightings& sightings = landmark.sightings;
  sightings.seen_s = sightings.expected_s = sightings.familiar_seen_s = 5.0;
  sightings.seen_through_since_s = 3.0;
  sightings.hollow_s = 1.0;
  EXPECT_EQ(life_cycle_state(landmark, {}, false), LandmarkState::kCandidate) << "a fifth of the time, with a box";
  sightings.hollow_s = 3.0;
  EXPECT_EQ(life_cycle_state(landmark, {}, false), LandmarkState::kRetired) << "what lies behind it was never seen";
}

TEST_F(DepthMapperTest, WhatIsHollowIsThereAsLongAsSomethingIsInsideIt) {
  const Ellipsoid chair = on_table(0.0, 0.0, Vec3::Constant(0.2));
  const Ellipsoid tv = on_table(-0.3, 0.2, Vec3(0.06, 0.2, 0.18));
  const auto with_inside = [&](const SE3& pose) {
    return DepthScene{{{SE3(pose.q, chair.center()), Vec3(0.18, 0.18, 0.01)}, tv}};
  };
  for (int i = 0; i < 60; ++i) {
    const SE3 pose = from_side(1.5 * i);
    step(pose, {{0, 62, chair}, {1, 62, tv}}, with_inside(pose));
  }
  ASSERT_EQ(find(0)->state, LandmarkState::kConfirmed);
  for (int i = 0; i < 60; ++i) step(from_side(1.5 * i), {{1, 62, tv}}, with_inside(from_side(1.5 * i)));
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed) << "its seat is behind its near side";
  for (int i = 0; i < 85; ++i) step(from_side(1.5 * i), {{1, 62, tv}}, {{tv}});
  EXPECT_EQ(find(0)->state, LandmarkState::kRetired);
}

TEST_F(DepthMapperTest, AnIgnoredBoxHidesNothingThatDepthSeesThrough) {
  const Ellipsoid tv = on_table(-0.3, 0.2, Vec3(0.06, 0.2, 0.18));
  for (int i = 0; i < 60; ++i) step(from_side(1.5 * i), {{0, 41, kCup}, {1, 62, tv}}, {{kCup, tv}});
  ASSERT_EQ(find(0)->state, LandmarkState::kConfirmed);
  for (int i = 0; i < 85; ++i) {
    const SE3 pose = from_side(1.5 * (i % 60));
    const Ellipsoid person{SE3(Quaternion::Identity(), 1.8 * kCup.center() - 0.8 * pose.t), Vec3::Constant(0.4)};
    step(pose, {{1, 62, tv}, {-1, 41, person}}, {{tv}});
  }
  EXPECT_EQ(find(0)->state, LandmarkState::kRetired) << "somebody sits behind where it was";
}

TEST_F(DepthMapperTest, WhatOneSessionSawThroughTheNextHasNotLookedAt) {
  const Ellipsoid tv = on_table(-0.3, 0.2, Vec3(0.06, 0.2, 0.18));
  for (int i = 0; i < 60; ++i) step(from_side(1.5 * i), {{0, 41, kCup}, {1, 62, tv}}, {{kCup, tv}});
  for (int i = 0; i < 45; ++i) step(from_side(1.5 * i), {{1, 62, tv}}, {{tv}});
  ASSERT_GT(mapper_.state().landmarks[0].sightings.seen_through_since_s, 1.0);
  ASSERT_EQ(find(0)->state, LandmarkState::kConfirmed);
  begin_session();
  EXPECT_EQ(mapper_.state().landmarks[0].sightings.seen_through_since_s, 0.0);
}

TEST_F(DepthMapperTest, WhatTheBorderCutsIsSeenThroughAsWellButNotMissed) {
  const DepthScene scene{{kCup}};
  const auto to_the_border = [](int i) {
    SE3 pose = from_side(1.5 * i);
    const double to_left_edge = -std::atan2(0.5 * kCamera.width, kCamera.fx);
    const Vec3 at = pose.inverse() * kCup.center();
    const double turn = std::atan2(at.x(), at.z()) - to_left_edge;
    pose.q = pose.q * Quaternion(Eigen::AngleAxisd(turn - 0.01, Vec3::UnitY()));
    return pose;
  };
  const Box box = box_of(kCup, to_the_border(0));
  ASSERT_LT(box.x1, -0.2 * box.width());
  ASSERT_GT(box.x2, 0.45 * box.width());
  for (int i = 0; i < 60; ++i) step(from_side(1.5 * i), {{0, 41, kCup}}, scene);
  ASSERT_EQ(find(0)->state, LandmarkState::kConfirmed);
  const auto something_else = [](const SE3& pose) {
    return Seen{-1, 62, {SE3(Quaternion::Identity(), pose * Vec3(0.0, 0.0, 1.4)), Vec3::Constant(0.1)}};
  };
  for (int i = 0; i < 60; ++i) step(to_the_border(i), {something_else(to_the_border(i))}, scene);
  EXPECT_EQ(find(0)->state, LandmarkState::kConfirmed) << "detectors miss what is cut";
  for (int i = 0; i < 85; ++i) step(to_the_border(i), {something_else(to_the_border(i))}, {});
  EXPECT_EQ(find(0)->state, LandmarkState::kRetired);
}

}  // namespace
}  // namespace semantic_topo_loop::core
