#include <gtest/gtest.h>

#include <functional>
#include <random>
#include <tuple>

#include "association/levels.h"
#include "association/track_store.h"
#include "semantic_topo_loop/association/associator_options.h"
#include "semantic_topo_loop/association/object_associator.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/geometry/quadric.h"

namespace semantic_topo_loop::core {
namespace {

const Camera kCamera{500.0, 500.0, 320.0, 240.0, 640, 480, {}};
constexpr int kPerson = 0, kCup = 41, kVase = 75, kBook = 73, kIgnored = 99;

std::shared_ptr<const ClassTable> classes() {
  return std::make_shared<const ClassTable>(*ClassTable::create({{kPerson, "person", ClassRole::kDynamic, "", 1.6},
                                                                 {kCup, "cup", ClassRole::kMovable, "vessel", 0.1},
                                                                 {kVase, "vase", ClassRole::kMovable, "vessel", 0.2},
                                                                 {kBook, "book", ClassRole::kMovable, "", 0.2},
                                                                 {kIgnored, "noise", ClassRole::kIgnore, "", 0.2}}));
}

Frame frame_at(std::int64_t id) {
  Frame frame;
  frame.frame_id = id;
  frame.stamp_ns = id * 33333333;
  frame.keyframe_id = id / 5;
  frame.is_keyframe = id % 5 == 0;
  frame.camera = kCamera;
  return frame;
}

Box box_at(double x, double y, double size = 60.0) { return {x - size / 2, y - size / 2, x + size / 2, y + size / 2}; }

/// What a mapper would say: landmark `id` is a sphere whose projection in the identity camera is around `box`.
MapUpdate sphere_update(const ObjectAssociator& associator, std::int64_t id, int class_id, const Box& box) {
  constexpr double kDepth_m = 2.0;
  Landmark landmark;
  landmark.id = id;
  landmark.class_id = class_id;
  landmark.observations = 40;
  landmark.mean_iou = 0.8;
  landmark.ellipsoid = Ellipsoid{SE3(Quaternion::Identity(), kDepth_m * kCamera.ray(box.center())),
                                 Vec3::Constant(0.5 * box.size() * kDepth_m / kCamera.fx)};
  MapUpdate update;
  update.base_version = associator.map_version();
  update.map_version = associator.map_version() + 1;
  update.changed.push_back(landmark);
  return update;
}

AssociatorOptions options(const std::string& mode, const std::string& levels = "2d,pro,3d") {
  AssociatorOptions result;
  result.mode = mode;
  result.levels = levels;
  return result;
}

class EveryMode : public testing::TestWithParam<std::string> {};
INSTANTIATE_TEST_SUITE_P(Modes, EveryMode, testing::Values("joint", "cascade", "jda"));

TEST_P(EveryMode, TracksAMovingBoxAndStartsANewLandmarkForAnotherObject) {
  ObjectAssociator associator(options(GetParam()), classes());
  std::int64_t id = -1;
  for (int k = 0; k < 20; ++k) {
    const AssociationFrame result = associator.associate(frame_at(k), {{kCup, 0.9, box_at(200.0 + 6.0 * k, 200.0)}});
    ASSERT_EQ(result.associations.size(), 1U);
    if (k == 0) {
      EXPECT_EQ(result.associations[0].level, AssociationLevel::kNew);
      id = result.associations[0].landmark_id;
    } else {
      EXPECT_NE(result.associations[0].level, AssociationLevel::kNew);
    }
    EXPECT_EQ(result.associations[0].landmark_id, id);
    EXPECT_EQ(result.associations[0].landmark_class_id, kCup);
  }
  const AssociationFrame other = associator.associate(frame_at(20), {{kBook, 0.9, box_at(500.0, 100.0)}});
  EXPECT_EQ(other.associations[0].level, AssociationLevel::kNew);
  EXPECT_NE(other.associations[0].landmark_id, id);
}

TEST(ObjectAssociator, OptionsChangeFromTheNextFrameOn) {
  AssociatorOptions changed = options("joint");
  ObjectAssociator associator(changed, classes());
  const std::vector<Detection> seen{{kCup, 0.6, box_at(300.0, 220.0)}};
  const std::int64_t id = associator.associate(frame_at(0), seen).associations[0].landmark_id;
  changed.min_score = 0.7;
  associator.set_options(changed);
  EXPECT_EQ(associator.associate(frame_at(1), seen).associations[0].level, AssociationLevel::kLowScore);
  changed.min_score = 0.5;
  associator.set_options(changed);
  EXPECT_EQ(associator.associate(frame_at(2), seen).associations[0].landmark_id, id) << "tracks are kept";
  changed.iou_2d_min = changed.iou_joint_2d_min = 0.9;  // of the scores, too
  associator.set_options(changed);
  EXPECT_EQ(associator.associate(frame_at(3), {{kCup, 0.6, box_at(310.0, 220.0)}}).associations[0].level,
            AssociationLevel::kNew);
}

TEST(ObjectAssociator, WhereTheDetectorDidNotLookNothingIsForgotten) {
  for (const bool looks : {true, false}) {
    SCOPED_TRACE(looks);
    ObjectAssociator associator(options("joint"), classes());
    const std::int64_t id =
        associator.associate(frame_at(0), {{kCup, 0.9, box_at(300.0, 220.0)}}).associations[0].landmark_id;
    for (int k = 1; k < 60; ++k) {
      const AssociationFrame between = looks ? associator.associate(frame_at(k), {}) : associator.pass(frame_at(k));
      EXPECT_EQ(between.unanswered, !looks);
      EXPECT_EQ(between.frame_id, k);
    }
    const AssociationFrame result = associator.associate(frame_at(60), {{kCup, 0.9, box_at(302.0, 220.0)}});
    EXPECT_EQ(result.associations[0].landmark_id == id, !looks);
  }
}

TEST_P(EveryMode, ABoxTellsNoPlaceAcrossABreakOrALongPause) {
  const auto is_found_again = [](const std::function<Frame(ObjectAssociator*)>& later) {
    ObjectAssociator associator(options(GetParam()), classes());
    const std::vector<Detection> cup{{kCup, 0.9, box_at(300.0, 220.0)}}, after{{kCup, 0.9, box_at(305.0, 220.0)}};
    const std::int64_t id = associator.associate(frame_at(0), cup).associations[0].landmark_id;
    const AssociationFrame result = associator.associate(later(&associator), after);
    return result.associations[0].landmark_id == id;
  };
  const auto broken = [](std::int64_t id) {
    Frame frame = frame_at(id);
    frame.is_break = true;
    return frame;
  };
  EXPECT_TRUE(is_found_again([](ObjectAssociator*) { return frame_at(1); }));
  EXPECT_TRUE(is_found_again([](ObjectAssociator*) { return frame_at(60); })) << "a slow detector";
  EXPECT_FALSE(is_found_again([&](ObjectAssociator*) { return broken(1); }));
  EXPECT_FALSE(is_found_again([](ObjectAssociator*) { return frame_at(1800); })) << "60 s";
  EXPECT_FALSE(is_found_again([&](ObjectAssociator* associator) {
    associator->pass(broken(1));
    return frame_at(2);
  })) << "the detector did not look when it broke";
}

TEST_P(EveryMode, QuadricBringsALandmarkBackAfterALongAbsence) {
  ObjectAssociator associator(options(GetParam()), classes());
  const Box box = box_at(300.0, 220.0);
  const std::int64_t id = associator.associate(frame_at(0), {{kCup, 0.9, box}}).associations[0].landmark_id;
  ASSERT_TRUE(associator.apply(sphere_update(associator, id, kCup, box)));
  const AssociationFrame result = associator.associate(frame_at(200), {{kCup, 0.9, box_at(306.0, 222.0)}});
  EXPECT_EQ(result.associations[0].landmark_id, id);
  EXPECT_EQ(result.map_version, associator.map_version());
}

TEST_P(EveryMode, QuadricBringsALandmarkBackAtTheBorderOfAWideLens) {
  ObjectAssociator associator(options(GetParam()), classes());
  const auto wide_frame = [](std::int64_t id) {
    Frame frame = frame_at(id);
    frame.camera = {458.654, 457.296, 367.215, 248.375, 752, 480, {-0.28340811, 0.07395907, 0.0, 0.0, 0.0}};
    return frame;
  };
  const Box raw = box_at(720.0, 240.0, 50.0);
  const Box box = wide_frame(0).camera.undistort(raw);
  ASSERT_GT(box.x1, 752.0) << "outside, were the lens none";
  const std::int64_t id = associator.associate(wide_frame(0), {{kCup, 0.9, raw}}).associations[0].landmark_id;
  MapUpdate update = sphere_update(associator, id, kCup, box);
  update.changed[0].ellipsoid->T_world_quadric.t = 2.0 * wide_frame(0).camera.ray(box.center());
  update.changed[0].baseline_deg = 20.0;
  ASSERT_TRUE(associator.apply(update));
  EXPECT_EQ(associator.associate(wide_frame(200), {{kCup, 0.9, raw}}).associations[0].landmark_id, id);
}

TEST_P(EveryMode, FollowsTheMapWhenACorrectionMovesIt) {
  ObjectAssociator associator(options(GetParam()), classes());
  const Box box = box_at(300.0, 220.0);
  const std::int64_t id = associator.associate(frame_at(0), {{kCup, 0.9, box}}).associations[0].landmark_id;
  MapUpdate update = sphere_update(associator, id, kCup, box);
  update.T_map_odom = SE3(so3_exp(Vec3(0.1, 0.7, -0.2)), Vec3(3.0, -2.0, 1.0));
  SE3& T_map_quadric = update.changed[0].ellipsoid->T_world_quadric;
  T_map_quadric = update.T_map_odom * T_map_quadric;
  ASSERT_TRUE(associator.apply(update));
  EXPECT_EQ(associator.associate(frame_at(200), {{kCup, 0.9, box}}).associations[0].landmark_id, id);
}

TEST_P(EveryMode, LeavesOutDynamicIgnoredLowAndCoveredBoxes) {
  ObjectAssociator associator(options(GetParam()), classes());
  const AssociationFrame result = associator.associate(frame_at(0), {{kPerson, 0.9, box_at(100.0, 100.0)},
                                                                     {kIgnored, 0.9, box_at(200.0, 100.0)},
                                                                     {kCup, 0.1, box_at(300.0, 100.0)},
                                                                     {kVase, 0.5, box_at(400.0, 101.0)},
                                                                     {kCup, 0.8, box_at(400.0, 100.0)}});
  ASSERT_EQ(result.associations.size(), 5U);
  EXPECT_EQ(result.associations[0].level, AssociationLevel::kIgnored);
  EXPECT_EQ(result.associations[1].level, AssociationLevel::kIgnored);
  EXPECT_EQ(result.associations[2].level, AssociationLevel::kLowScore);
  EXPECT_EQ(result.associations[3].level, AssociationLevel::kSuppressed);
  EXPECT_EQ(result.associations[4].level, AssociationLevel::kNew);
  for (int i = 0; i < 4; ++i) EXPECT_EQ(result.associations[static_cast<std::size_t>(i)].landmark_id, -1);
  for (int i = 0; i < 5; ++i) EXPECT_EQ(result.associations[static_cast<std::size_t>(i)].detection_index, i);
}

/// Near a corner that the lens model does not reach, undistorting turns boxes inside out, or gives no number.
TEST_P(EveryMode, LeavesOutBoxesThatTheLensModelDoesNotReach) {
  ObjectAssociator associator(options(GetParam()), classes());
  Frame frame = frame_at(0);
  frame.camera.distortion[0] = -0.5;
  const Box corner{540.0, 300.0, 639.0, 400.0};
  ASSERT_FALSE(frame.camera.undistort(corner).is_valid());
  const AssociationFrame result = associator.associate(frame, {{kCup, 0.9, corner}, {kCup, 0.8, box_at(300.0, 220.0)}});
  EXPECT_EQ(result.associations[0].level, AssociationLevel::kIgnored);
  EXPECT_EQ(result.associations[0].landmark_id, -1);
  EXPECT_TRUE(result.associations[0].box.is_finite());
  EXPECT_EQ(result.associations[1].level, AssociationLevel::kNew);
}

TEST(ObjectAssociator, JointGivesEachLandmarkOneBoxWhereTheCascadeGivesTwo) {
  for (const bool joint : {true, false}) {
    ObjectAssociator associator(options(joint ? "joint" : "cascade"), classes());
    associator.associate(frame_at(0), {{kCup, 0.9, box_at(300.0, 200.0, 80.0)}});
    const AssociationFrame result = associator.associate(
        frame_at(1), {{kCup, 0.9, box_at(300.0, 200.0, 80.0)}, {kCup, 0.8, box_at(310.0, 200.0, 66.0)}});
    const bool shared = result.associations[0].landmark_id == result.associations[1].landmark_id;
    EXPECT_EQ(shared, !joint);
  }
}

TEST(ObjectAssociator, JointSurvivesMissedFramesAndAWrongLabel) {
  ObjectAssociator associator(options("joint"), classes());
  const std::int64_t id =
      associator.associate(frame_at(0), {{kCup, 0.9, box_at(300.0, 200.0)}}).associations[0].landmark_id;
  for (int k = 1; k < 5; ++k) associator.associate(frame_at(k), {});
  const AssociationFrame missed = associator.associate(frame_at(5), {{kCup, 0.9, box_at(304.0, 200.0)}});
  EXPECT_EQ(missed.associations[0].landmark_id, id);
  const AssociationFrame renamed = associator.associate(frame_at(6), {{kVase, 0.9, box_at(305.0, 200.0)}});
  EXPECT_EQ(renamed.associations[0].landmark_id, id);
  EXPECT_EQ(renamed.associations[0].landmark_class_id, kCup);
  const AssociationFrame unrelated = associator.associate(frame_at(7), {{kBook, 0.9, box_at(305.0, 200.0)}});
  EXPECT_NE(unrelated.associations[0].landmark_id, id);
}

TEST(ObjectAssociator, LevelsCanBeSwitchedOff) {
  const auto level_of_second = [](const std::string& levels) {
    ObjectAssociator associator(options("cascade", levels), classes());
    const Box box = box_at(300.0, 220.0);
    const std::int64_t id = associator.associate(frame_at(0), {{kCup, 0.9, box}}).associations[0].landmark_id;
    associator.apply(sphere_update(associator, id, kCup, box));
    return associator.associate(frame_at(1), {{kCup, 0.9, box_at(302.0, 221.0)}}).associations[0].level;
  };
  EXPECT_EQ(level_of_second("2d"), AssociationLevel::k2d);
  EXPECT_EQ(level_of_second("pro"), AssociationLevel::kPosterior);
  EXPECT_EQ(level_of_second("3d"), AssociationLevel::k3d);
  EXPECT_EQ(level_of_second("2d,pro,3d"), AssociationLevel::k2d);
}

TEST(ObjectAssociator, PosteriorPrefersTheNearerOfTwoLandmarksWhateverTheirCounts) {
  ObjectAssociator associator(options("cascade", "pro"), classes());
  for (int k = 0; k < 200; ++k) associator.associate(frame_at(k), {{kCup, 0.9, box_at(200.0, 200.0)}});
  const AssociationFrame both =
      associator.associate(frame_at(200), {{kCup, 0.9, box_at(200.0, 200.0)}, {kCup, 0.9, box_at(300.0, 200.0)}});
  ASSERT_NE(both.associations[0].landmark_id, both.associations[1].landmark_id);
  const AssociationFrame next = associator.associate(frame_at(201), {{kCup, 0.9, box_at(265.0, 200.0)}});
  EXPECT_EQ(next.associations[0].landmark_id, both.associations[1].landmark_id);
}

TEST(ObjectAssociator, PointsStandInForAMissingQuadric) {
  ObjectAssociator associator(options("cascade", "3d"), classes());
  auto points = std::make_shared<std::vector<Vec3>>();
  for (int i = -4; i <= 4; ++i) {
    for (int j = -4; j <= 4; ++j) points->push_back({0.02 * i, 0.02 * j, 2.0});
  }
  Frame frame = frame_at(0);
  frame.points_camera = points;
  const std::int64_t id =
      associator.associate(frame, {{kCup, 0.9, box_at(320.0, 240.0, 70.0)}}).associations[0].landmark_id;
  Frame moved = frame_at(30);
  moved.T_odom_camera.t = Vec3(0.2, 0.0, 0.0);  // the object is now 50 px to the left
  const AssociationFrame result = associator.associate(moved, {{kCup, 0.9, box_at(270.0, 240.0, 70.0)}});
  EXPECT_EQ(result.associations[0].landmark_id, id);
  EXPECT_EQ(result.associations[0].level, AssociationLevel::k3d);
}

/// A grid of points at a depth, in a square of pixels.
void add_wall(const Box& pixels, double depth_m, std::vector<Vec3>* points) {
  for (double u = pixels.x1; u <= pixels.x2; u += 4.0) {
    for (double v = pixels.y1; v <= pixels.y2; v += 4.0) points->push_back(depth_m * kCamera.ray(Vec2(u, v)));
  }
}

Frame frame_with(std::int64_t id, std::vector<Vec3> points) {
  Frame frame = frame_at(id);
  frame.points_camera = std::make_shared<const std::vector<Vec3>>(std::move(points));
  return frame;
}

std::shared_ptr<const ClassTable> sized_classes() {
  return std::make_shared<const ClassTable>(
      *ClassTable::create({{kCup, "cup", ClassRole::kMovable, "", 0.1, 0.05, 0.2},
                           {kBook, "book", ClassRole::kMovable, "", 0.25, 0.1, 0.5}}));
}

TEST(ObjectAssociator, WhatDepthMakesTooLargeOrTooSmallForItsClassIsLeftOut) {
  ObjectAssociator associator(options("joint"), sized_classes());
  const Box box = box_at(320.0, 240.0, 100.0), at_border{0.0, 200.0, 60.0, 260.0};
  for (const auto& [depth_m, is_cup, is_book] :
       {std::tuple(0.2, false, false), std::tuple(0.5, true, true), std::tuple(1.5, false, true)}) {
    for (const auto& [class_id, fits] : {std::pair(kCup, is_cup), std::pair(kBook, is_book)}) {
      std::vector<Vec3> points;
      add_wall(box, depth_m, &points);
      const AssociationFrame result = associator.associate(frame_with(0, points), {{class_id, 0.9, box}});
      EXPECT_EQ(result.associations[0].level == AssociationLevel::kWrongSize, !fits) << depth_m << ' ' << class_id;
      EXPECT_EQ(result.associations[0].landmark_id >= 0, fits);
    }
  }
  std::vector<Vec3> points;
  add_wall(at_border, 0.3, &points);
  EXPECT_GE(associator.associate(frame_with(1, points), {{kBook, 0.9, at_border}}).associations[0].landmark_id, 0)
      << "the rest of it is not in the image";
}

TEST(ObjectAssociator, DepthTellsWhatStandsInFrontAndWhatIsOneThingUnderTwoNames) {
  ObjectAssociator associator(options("joint"), sized_classes());
  const Box box = box_at(320.0, 240.0);
  std::vector<Vec3> at_2m, at_1m;
  add_wall(box, 2.0, &at_2m);
  add_wall(box, 1.0, &at_1m);
  const std::int64_t book = associator.associate(frame_with(0, at_2m), {{kBook, 0.9, box}}).associations[0].landmark_id;
  ASSERT_TRUE(associator.apply(sphere_update(associator, book, kBook, box)));
  EXPECT_NE(associator.associate(frame_with(1, at_1m), {{kBook, 0.9, box}}).associations[0].landmark_id, book)
      << "the same box, a metre in front";
  // The book's box called a cup would be too large for one; what is 0.2 m may be either.
  std::vector<Vec3> near;
  add_wall(box, 1.5, &near);
  ObjectAssociator other(options("joint"), sized_classes());
  const std::int64_t cup = other.associate(frame_with(0, near), {{kCup, 0.9, box}}).associations[0].landmark_id;
  MapUpdate update = sphere_update(other, cup, kCup, box);
  update.changed[0].ellipsoid->T_world_quadric.t *= 0.75;
  update.changed[0].ellipsoid->semi_axes *= 0.75;
  ASSERT_TRUE(other.apply(update));
  const AssociationFrame renamed = other.associate(frame_with(1, near), {{kBook, 0.4, box}});
  EXPECT_EQ(renamed.associations[0].landmark_id, cup);
  EXPECT_EQ(renamed.associations[0].landmark_class_id, kCup) << "0.9 against 0.4";
}

TEST(ObjectAssociator, OfTwoDepthsInABoxItsLandmarkTellsWhichIsTheObject) {
  ObjectAssociator associator(options("joint"), classes());
  const Box box = box_at(320.0, 240.0);
  std::vector<Vec3> both;  // in the left half of the box, and beside it, something stands in front
  add_wall({box.x1 - box.width(), box.y1, box.center().x(), box.y2}, 1.0, &both);
  add_wall({box.center().x() + 4.0, box.y1, box.x2, box.y2}, 2.0, &both);
  const Association first = associator.associate(frame_with(0, both), {{kBook, 0.9, box}}).associations[0];
  EXPECT_GE(first.landmark_id, 0);
  EXPECT_FALSE(first.has_depth()) << "one image does not tell";
  ASSERT_TRUE(associator.apply(sphere_update(associator, first.landmark_id, kBook, box)));
  const Association again = associator.associate(frame_with(1, both), {{kBook, 0.9, box}}).associations[0];
  EXPECT_EQ(again.landmark_id, first.landmark_id);
  EXPECT_NEAR(again.near_m, 2.0, 0.01);
}

TEST(ObjectAssociator, ABoxInsideAnotherOnTheSameThingIsSuppressed) {
  ObjectAssociator associator(options("joint"), sized_classes());
  const Box box{290.0, 200.0, 350.0, 280.0}, lower{290.0, 228.0, 350.0, 280.0};
  std::vector<Vec3> points;
  add_wall(box, 1.0, &points);
  const std::vector<Detection> two{{kCup, 0.8, box}, {kBook, 0.4, lower}};
  EXPECT_EQ(associator.associate(frame_with(0, points), two).associations[1].level, AssociationLevel::kSuppressed);
  ObjectAssociator blind(options("joint"), sized_classes());
  EXPECT_EQ(blind.associate(frame_at(0), two).associations[1].level, AssociationLevel::kNew);
}

TEST(ObjectAssociator, MergeRemovalRetirementAndVersionGap) {
  ObjectAssociator associator(options("joint"), classes());
  const AssociationFrame first = associator.associate(
      frame_at(0),
      {{kCup, 0.9, box_at(100.0, 200.0)}, {kCup, 0.9, box_at(300.0, 200.0)}, {kBook, 0.9, box_at(500.0, 200.0)}});
  const std::int64_t a = first.associations[0].landmark_id, b = first.associations[1].landmark_id,
                     c = first.associations[2].landmark_id;
  MapUpdate update;
  update.map_version = 1;
  update.merged.push_back({b, a});
  update.removed.push_back(c);
  ASSERT_TRUE(associator.apply(update));
  // The survivor was last seen where both were: at its own or at the merged one's box.
  const AssociationFrame second =
      associator.associate(frame_at(1), {{kCup, 0.9, box_at(100.0, 200.0)}, {kBook, 0.9, box_at(500.0, 200.0)}});
  EXPECT_EQ(second.associations[0].landmark_id, a);
  EXPECT_GT(second.associations[1].landmark_id, c);  // ids are never used twice

  MapUpdate gap;
  gap.base_version = 7;
  gap.map_version = 8;
  EXPECT_FALSE(associator.apply(gap));
  EXPECT_EQ(associator.map_version(), 1U);

  const Box box = box_at(320.0, 400.0);
  const std::int64_t d = associator.associate(frame_at(2), {{kBook, 0.9, box}}).associations[0].landmark_id;
  MapUpdate retire = sphere_update(associator, d, kBook, box);
  retire.changed[0].state = LandmarkState::kRetired;
  ASSERT_TRUE(associator.apply(retire));
  EXPECT_NE(associator.associate(frame_at(3), {{kBook, 0.9, box}}).associations[0].landmark_id, d);
}

/// Tells of merges taken back and made.
bool apply(const std::vector<LandmarkMerge>& unmerged, const std::vector<LandmarkMerge>& merged,
           ObjectAssociator* associator) {
  MapUpdate update;
  update.base_version = associator->map_version();
  update.map_version = update.base_version + 1;
  update.unmerged = unmerged;
  update.merged = merged;
  return associator->apply(update);
}

TEST(ObjectAssociator, ALaterSessionKnowsWhatAnObjectWasCalled) {
  ObjectAssociator associator(options("joint"), classes());
  const Box box = box_at(320.0, 240.0);
  MapUpdate update = sphere_update(associator, 0, kCup, box);
  update.changed.front().class_counts = {{kCup, 21}, {kVase, 19}};
  ASSERT_TRUE(associator.apply(update));
  AssociationFrame seen;
  for (int i = 0; i < 4; ++i) seen = associator.associate(frame_at(i), {{kVase, 0.9, box}});
  EXPECT_EQ(seen.associations[0].landmark_id, 0);
  EXPECT_EQ(seen.associations[0].landmark_class_id, kVase);
}

TEST(ObjectAssociator, AMergeGivesTheSurvivorTheLabelsOfBoth) {
  ObjectAssociator associator(options("joint"), classes());
  const Box left = box_at(150.0, 240.0), right = box_at(450.0, 240.0);
  const AssociationFrame first = associator.associate(frame_at(0), {{kCup, 0.9, left}, {kVase, 0.9, right}});
  for (int i = 1; i < 3; ++i) associator.associate(frame_at(i), {{kVase, 0.9, right}});
  ASSERT_TRUE(apply({}, {{first.associations[1].landmark_id, first.associations[0].landmark_id}}, &associator));
  const AssociationFrame next = associator.associate(frame_at(3), {{kVase, 0.9, right}});
  EXPECT_EQ(next.associations[0].landmark_id, first.associations[0].landmark_id);
  EXPECT_EQ(next.associations[0].landmark_class_id, kVase);
}

TEST(ObjectAssociator, AMergeTakenBackGivesBothTracksTheirOwn) {
  ObjectAssociator associator(options("joint"), classes());
  const Box left = box_at(150.0, 240.0), right = box_at(450.0, 240.0);
  const AssociationFrame first = associator.associate(frame_at(0), {{kCup, 0.9, left}, {kVase, 0.9, right}});
  const std::int64_t a = first.associations[0].landmark_id, b = first.associations[1].landmark_id;
  ASSERT_TRUE(apply({}, {{b, a}}, &associator));
  ASSERT_TRUE(apply({{b, a}}, {}, &associator));
  const AssociationFrame next = associator.associate(frame_at(1), {{kCup, 0.9, left}, {kVase, 0.9, right}});
  EXPECT_EQ(next.associations[0].landmark_id, a);
  EXPECT_EQ(next.associations[0].landmark_class_id, kCup);
  EXPECT_EQ(next.associations[1].landmark_id, b);
  EXPECT_EQ(next.associations[1].landmark_class_id, kVase);
}

/// A vase and a book were taken for one, and both for a cup.
TEST(ObjectAssociator, AMergeTakenBackLeavesNoLabelsAlongItsChain) {
  ObjectAssociator associator(options("joint"), classes());
  const Box left = box_at(100.0, 240.0), middle = box_at(320.0, 240.0), right = box_at(540.0, 240.0);
  const std::vector<Detection> seen{{kCup, 0.5, left}, {kVase, 0.45, middle}, {kBook, 0.9, right}};
  AssociationFrame last;
  for (int k = 0; k < 5; ++k) last = associator.associate(frame_at(k), seen);
  const std::int64_t cup = last.associations[0].landmark_id, vase = last.associations[1].landmark_id,
                     book = last.associations[2].landmark_id;
  ASSERT_TRUE(apply({}, {{book, vase}, {vase, cup}}, &associator));
  ASSERT_TRUE(apply({{book, vase}}, {}, &associator));
  const AssociationFrame without_book = associator.associate(frame_at(5), {seen[0], seen[2]});
  EXPECT_EQ(without_book.associations[0].landmark_id, cup);
  EXPECT_EQ(without_book.associations[0].landmark_class_id, kCup);
  EXPECT_EQ(without_book.associations[1].landmark_id, book);
  EXPECT_EQ(without_book.associations[1].landmark_class_id, kBook);
  ASSERT_TRUE(apply({{vase, cup}}, {}, &associator));
  const AssociationFrame apart = associator.associate(frame_at(6), seen);
  EXPECT_EQ(apart.associations[0].landmark_id, cup);
  EXPECT_EQ(apart.associations[0].landmark_class_id, kCup);
  EXPECT_EQ(apart.associations[1].landmark_id, vase);
  EXPECT_EQ(apart.associations[1].landmark_class_id, kVase);
}

TEST(ObjectAssociator, TheFirstMergesAreForgotten) {
  ObjectAssociator associator(options("joint"), classes());
  constexpr auto kMerges = static_cast<std::int64_t>(kMostOpenMerges) + 1;
  const Box forgotten = box_at(150.0, 240.0), remembered = box_at(450.0, 240.0);
  MapUpdate landmarks, merge, undo;
  landmarks.map_version = merge.base_version = 1;
  merge.map_version = undo.base_version = 2;
  undo.map_version = 3;
  for (std::int64_t id = 0; id <= kMerges; ++id) {
    const Box box = id == 1 ? forgotten : id == 2 ? remembered : box_at(320.0, 80.0);
    landmarks.changed.push_back(sphere_update(associator, id, kCup, box).changed.front());
    if (id > 0) merge.merged.push_back({id, 0});
  }
  undo.unmerged = {{2, 0}, {1, 0}};
  for (const MapUpdate& update : {landmarks, merge, undo}) ASSERT_TRUE(associator.apply(update));
  const AssociationFrame result = associator.associate(frame_at(0), {{kCup, 0.9, forgotten}, {kCup, 0.9, remembered}});
  EXPECT_GT(result.associations[0].landmark_id, kMerges) << "a new one";
  EXPECT_EQ(result.associations[1].landmark_id, 2);
}

TEST(TrackStore, AViewWithoutBoundsDoesNotVisitEveryCell) {
  TrackStore store;
  Track& track = store.create(0);
  track.has_ellipsoid = true;
  track.center_map = Vec3(0.0, 0.0, 3.0);
  track.shape_map = 0.01 * Mat3::Identity();
  store.place(&track);
  Camera camera = frame_at(0).camera;
  camera.fx = camera.fy = 1e-6;
  EXPECT_EQ(store.near(camera, SE3(), 10.0, [](const Track&) { return false; }).size(), 1u);
}

/// The grid may return more than what is in view, never less, and each track once, in order.
TEST(TrackStore, FindsWhatALinearScanFindsAsLandmarksComeMoveAndGo) {
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> place(-25.0, 25.0), size(0.05, 1.5), angle(-3.0, 3.0), unit(0.0, 1.0);
  const auto scatter = [&](Track* track) {
    track->has_ellipsoid = true;
    track->center_map = Vec3(place(random), place(random), place(random));
    track->shape_map = std::pow(size(random), 2) * Mat3::Identity();
  };
  TrackStore store;
  std::vector<std::int64_t> ids;
  constexpr double kRange_m = 10.0;
  std::size_t in_view = 0;
  for (std::int64_t id = 0; id < 3000; ++id) {
    Track& track = store.create(id);
    scatter(&track);
    store.place(&track);
    ids.push_back(id);
    const std::int64_t other = ids[static_cast<std::size_t>(unit(random) * static_cast<double>(ids.size()))];
    if (Track* moved = store.find(other)) {
      if (unit(random) < 0.3) {
        store.erase(other);
      } else {
        scatter(moved);
        store.place(moved);
      }
    }
    if (id % 50 != 0) continue;
    const SE3 T_map_camera(so3_exp(Vec3(angle(random), angle(random), angle(random))),
                           Vec3(place(random), place(random), place(random)));
    const Mat34 P = projection_matrix(kCamera, T_map_camera);
    const auto found = store.near(kCamera, T_map_camera, kRange_m, [](const Track&) { return false; });
    EXPECT_TRUE(std::is_sorted(found.begin(), found.end(), [](auto* a, auto* b) { return a->id <= b->id; }));
    for (const Track* candidate : store.all()) {
      const auto box = project_box(candidate->center_map, candidate->shape_map, P);
      const double radius = std::sqrt(candidate->shape_map(0, 0));
      if (!box || clip(*box, kCamera.width, kCamera.height).area() <= 0.0) continue;
      if ((candidate->center_map - T_map_camera.t).norm() + radius > kRange_m) continue;
      ++in_view;
      EXPECT_NE(std::find(found.begin(), found.end(), candidate), found.end()) << candidate->id;
    }
  }
  EXPECT_GT(in_view, 100U);
}

TEST(ObjectAssociator, MarksSidesAtTheBorderAndUndistorts) {
  ObjectAssociator associator(options("joint"), classes());
  Frame frame = frame_at(0);
  frame.camera.distortion = {0.2, -0.7, 0.0, 0.0, 0.9};
  const AssociationFrame result = associator.associate(frame, {{kCup, 0.9, {0.0, 100.0, 80.0, 479.0}}});
  EXPECT_EQ(result.associations[0].truncated, kLeft | kBottom);
  const Box expected = frame.camera.undistort(Box{0.0, 100.0, 80.0, 479.0});
  EXPECT_EQ(result.associations[0].box.edges(), expected.edges());
  EXPECT_NE(result.associations[0].box.x1, 0.0);
}

TEST(ObjectAssociator, TheBorderIsAsWideAsTheImage) {
  ObjectAssociator associator(options("joint"), classes());
  Frame frame = frame_at(0);
  const Detection box{kCup, 0.9, {12.0, 200.0, 80.0, 260.0}};
  EXPECT_EQ(associator.associate(frame, {box}).associations[0].truncated, 0) << "of 640 pixels";
  frame = frame_at(1);
  frame.camera.width *= 2;
  frame.camera.height *= 2;
  EXPECT_EQ(associator.associate(frame, {box}).associations[0].truncated, kLeft) << "of 1280 pixels";
}

TEST(ObjectAssociator, BoxesEndWithTheImage) {
  ObjectAssociator associator(options("joint"), classes());
  const Frame frame = frame_at(0);
  const AssociationFrame result = associator.associate(
      frame, {{kCup, 0.9, {-30.0, 100.0, 80.0, 9000.0}}, {kCup, 0.9, {-90.0, 100.0, -5.0, 300.0}}});
  EXPECT_EQ(result.associations[0].truncated, kLeft | kBottom);
  const double height = frame.camera.height;
  EXPECT_EQ(result.associations[0].box.edges(), frame.camera.undistort(Box{0.0, 100.0, 80.0, height}).edges());
  EXPECT_EQ(result.associations[1].level, AssociationLevel::kIgnored);
}

TEST(AssociatorOptions, RejectsByNameAndValue) {
  AssociatorOptions bad_mode;
  bad_mode.mode = "magic";
  EXPECT_EQ(validate(bad_mode).message(), "parameter 'association.mode' = 'magic' must be joint, cascade or jda");
  AssociatorOptions bad_levels;
  bad_levels.levels = "2d,4d";
  EXPECT_EQ(validate(bad_levels).message(),
            "parameter 'association.levels' = '2d,4d' must be a comma-separated list of 2d, pro, 3d");
  AssociatorOptions bad_gate;
  bad_gate.iou_3d_min = -0.1;
  EXPECT_EQ(validate(bad_gate).message(), "parameter 'association.iou_3d_min' = '-0.1' must be in [0, 1]");
}

}  // namespace
}  // namespace semantic_topo_loop::core
