#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <memory>
#include <random>
#include <vector>

#include "geometry/depth_points.h"
#include "loop/graph/graph_detector.h"
#include "loop/graph/odometry_monitor.h"
#include "loop/submap/observation_window.h"
#include "loop/submap/submap_builder.h"
#include "loop/submap/submap_refiner.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "support/depth_scene.h"
#include "support/synthetic_desk.h"

namespace semantic_topo_loop::core {
namespace {

using testing::DepthScene;
using testing::desk_camera;
using testing::desk_classes;
using testing::DeskObject;
using testing::on_table;
using testing::random_desk;
using testing::uniform;

struct BuiltMap {
  LocalMap map;
  SE3 T_world_anchor;
};

/// A submap from a sweep around the desk. `mirrored` flips the world and the images.
/// @param change of what is observed in a frame
BuiltMap sweep(const std::vector<DeskObject>& desk, double begin_deg, double end_deg, std::uint64_t seed,
               const std::function<void(const SE3& T_world_camera, Association*)>& change = nullptr,
               const LoopOptions& options = {}) {
  ObservationWindow window(options.window_s, options.frame_interval_s, *desk_classes());
  UpEstimator up(options.up_window_s);
  FrameBuilder builder(KeyframeOptions(), desk_camera());
  std::mt19937_64 random(seed);
  std::vector<SE3> poses;
  for (std::int64_t k = 0; k < 80; ++k) {
    const SE3 pose = testing::desk_pose({{0.0, 8.0, begin_deg, end_deg}}, 0.1 * static_cast<double>(k));
    const auto frame = builder.build({k * 100'000'000, pose});
    AssociationFrame associations = testing::observe(desk, *frame, pose, 0, random);
    for (Association& association : associations.associations) {
      if (change) change(pose, &association);
    }
    window.push(*frame, associations);
    up.push(*frame);
    poses.push_back(pose);
  }
  const auto map = build_local_map(window.frames(), LandmarkRedirects(), up, options);
  return {*map, poses[static_cast<std::size_t>(map->frame_id)]};
}

/// Objects of the map that lie within 4 cm of one of the desk's of the same class.
int right_objects(const BuiltMap& built, const std::vector<DeskObject>& desk) {
  int right = 0;
  for (const LocalObject& object : built.map.objects) {
    const Vec3 center = built.T_world_anchor * object.spheroid.center;
    for (const DeskObject& truth : desk) {
      if (truth.class_id == object.label && (truth.spheroid.center - center).norm() < 0.04) ++right;
    }
  }
  return right;
}

TEST(LocalMap, FindsTheObjects) {
  const auto desk = random_desk(1, 12);
  const BuiltMap built = sweep(desk, 0.0, 60.0, 5);
  EXPECT_GE(right_objects(built, desk), 11);
  EXPECT_LE(built.map.objects.size(), 13u);
  EXPECT_EQ(built.map.begin_frame, 0);
  EXPECT_EQ(built.map.end_frame, 79);
}

TEST(LocalMap, SplitsAnIdThatHoldsSeveralObjects) {
  const auto desk = random_desk(1, 12);
  const BuiltMap built =
      sweep(desk, 0.0, 60.0, 5, [](const SE3&, Association* seen) { seen->landmark_id = seen->class_id; });
  EXPECT_GE(right_objects(built, desk), 11);
}

TEST(LocalMap, EstimatesUp) {
  const BuiltMap built = sweep(random_desk(2, 10), 0.0, 90.0, 5);
  ASSERT_TRUE(built.map.up.certain);
  EXPECT_GT((built.T_world_anchor.q * built.map.up.direction).z(), std::cos(radians(2.0)));
}

TEST(LocalMap, UpIsUncertainWithoutTurning) {
  const BuiltMap built = sweep(random_desk(2, 10), 40.0, 45.0, 5);
  EXPECT_FALSE(built.map.up.certain);
}

TEST(LocalMap, HasSurfacesAndFeaturesOfItsFramesWherePointsAreUsed) {
  ObservationWindow window(15.0, 0.09, *desk_classes());
  std::vector<Vec3> wall;
  for (int i = 0; i < 900; ++i) {
    const int column = i % 30, row = i / 30;
    wall.emplace_back(0.03 * column, 0.03 * row, 2.0);
  }
  Frame frame;
  frame.camera = desk_camera();
  frame.is_keyframe = true;
  frame.points_camera = std::make_shared<const std::vector<Vec3>>(std::move(wall));
  frame.features = std::make_shared<const std::vector<PointFeature>>(7);
  window.push(frame, {});
  LoopOptions options;
  const UpEstimator up(options.up_window_s);
  const auto map = [&] { return *build_local_map(window.frames(), LandmarkRedirects(), up, options); };
  ASSERT_NE(map().surfels, nullptr);
  EXPECT_GT(map().surfels->size(), 100U);
  ASSERT_NE(map().features, nullptr);
  EXPECT_EQ(map().features->size(), 1U) << "of one id";
  options.scale = "free";
  EXPECT_TRUE(map().surfels == nullptr && map().features == nullptr);
  options.scale = "fixed";
  options.use_points = false;
  EXPECT_TRUE(map().surfels == nullptr && map().features == nullptr);
}

/// Of what is seen of the desk, such that its centre is told.
double near_m(const std::vector<DeskObject>& desk, const SE3& T_world_camera, const Association& seen) {
  const DeskObject& object = desk[static_cast<std::size_t>(seen.landmark_id)];
  const double depth_m = (T_world_camera.inverse() * object.spheroid.center).z();
  const double narrow_px = std::min(seen.box.width(), seen.box.height());
  return depth_m - near_side_m(0.5 * depth_m * narrow_px / desk_camera().fx);
}

TEST(LocalMap, DepthPlacesWhatIsSeenFromOneSide) {
  const auto desk = random_desk(1, 12);
  LoopOptions options;
  options.min_parallax_deg = 60.0;  // the rays of this sweep meet at less
  EXPECT_TRUE(sweep(desk, 0.0, 30.0, 5, nullptr, options).map.objects.empty());
  const auto with_depth = [&desk](const SE3& pose, Association* seen) { seen->near_m = near_m(desk, pose, *seen); };
  const BuiltMap built = sweep(desk, 0.0, 30.0, 5, with_depth, options);
  EXPECT_GE(right_objects(built, desk), 10);
  EXPECT_LE(built.map.objects.size(), 13U);
}

TEST(LocalMap, WhatTheBorderCutsIsFoundByTheSidesThatAreSeen) {
  const auto desk = random_desk(1, 12);
  constexpr std::int64_t kCut = 3;
  const auto find = [&desk](bool has_depth, int frames_a_side) {
    int frame = 0;
    const BuiltMap built = sweep(desk, 0.0, 30.0, 5, [&](const SE3& pose, Association* seen) {
      if (seen->landmark_id != kCut) return;
      // Two thirds of it, by turns without its right and its left.
      Box& box = seen->box;
      const double third = box.width() / 3.0;
      const bool is_right = frame++ / frames_a_side % 2 == 0;
      (is_right ? box.x2 : box.x1) += is_right ? -third : third;
      seen->truncated = static_cast<std::uint8_t>(seen->truncated | (is_right ? 4 : 1));
      if (has_depth) seen->near_m = near_m(desk, pose, *seen);
    });
    double nearest_m = std::numeric_limits<double>::infinity();
    const Vec3 truth = built.T_world_anchor.inverse() * desk[kCut].spheroid.center;
    for (const LocalObject& object : built.map.objects) {
      if (object.landmark_id == kCut) nearest_m = std::min(nearest_m, (object.spheroid.center - truth).norm());
    }
    return nearest_m;
  };
  EXPECT_LT(find(true, 10), 0.03);
  EXPECT_LT(find(true, 1000), 0.06) << "one side is never seen";
  EXPECT_GT(find(false, 10), 1.0) << "without depth it has no place";
}

TEST(LocalMap, IsEmptyWithoutAKeyframe) {
  const LoopOptions options;
  const UpEstimator up(options.up_window_s);
  EXPECT_FALSE(build_local_map({}, LandmarkRedirects(), up, options).has_value());
}

/// Twenty frames without a box at 10 Hz.   @param answer_each of so many frames the detector looked at one
ObservationWindow window_with_break(std::int64_t at, std::int64_t answer_each) {
  ObservationWindow window(8.0, 0.09, *desk_classes());
  Frame frame;
  frame.camera = desk_camera();
  for (std::int64_t k = 0; k < 20; ++k) {
    frame.frame_id = k;
    frame.stamp_ns = k * 100'000'000;
    frame.is_break = k == at;
    AssociationFrame associations;
    associations.unanswered = k % answer_each != 0;
    EXPECT_EQ(window.push(frame, associations), !associations.unanswered);
  }
  return window;
}

TEST(ObservationWindow, StartsAfreshAtABreak) {
  const ObservationWindow window = window_with_break(15, 1);
  ASSERT_EQ(window.frames().size(), 5u);
  EXPECT_EQ(window.frames().front().frame_id, 15);
}

TEST(ObservationWindow, FramesThatWereGivenAnEarlierPoseWereOnTheWay) {
  constexpr std::int64_t kInterval_ns = 100'000'000;
  ObservationWindow window(8.0, 0.0, *desk_classes());
  const auto push = [&window](int i, double x, std::optional<std::int64_t> held_since_ns = {}) {
    Frame frame;
    frame.frame_id = i;
    frame.stamp_ns = i * kInterval_ns;
    frame.T_odom_camera.t.x() = x;
    frame.held_since_ns = held_since_ns;
    window.push(frame, {});
  };
  push(0, 0.0);
  for (int i = 1; i < 5; ++i) push(i, 0.1);
  push(5, 0.5, kInterval_ns);
  for (const ObservedFrame& frame : window.frames()) {
    EXPECT_NEAR(frame.T_odom_camera.t.x(), 0.1 * static_cast<double>(frame.frame_id), 1e-12) << frame.frame_id;
  }
  // What was held has left the window.
  window.clear();
  push(6, 0.6, kInterval_ns);
  EXPECT_EQ(window.frames().front().T_odom_camera.t.x(), 0.6);
}

TEST(ObservationWindow, LeavesOutWhereTheDetectorDidNotLook) {
  const ObservationWindow window = window_with_break(4, 3);
  ASSERT_EQ(window.frames().size(), 5u);
  EXPECT_EQ(window.frames().front().frame_id, 6) << "the break counts, whether the detector looked or not";
}

TEST(ObservationWindow, LeavesOutWhatIsNoLandmark) {
  ObservationWindow window(8.0, 0.09, *desk_classes());
  Frame frame;
  frame.camera = desk_camera();
  AssociationFrame associations;
  Association association;
  association.box = {100, 100, 150, 160};
  association.class_id = 7;  // dynamic
  association.landmark_id = 3;
  associations.associations.push_back(association);
  association.class_id = 2;
  association.landmark_id = -1;
  associations.associations.push_back(association);
  association.landmark_id = 4;
  association.box.x2 = 90;  // inverted
  associations.associations.push_back(association);
  association.box.x2 = 150;
  associations.associations.push_back(association);
  window.push(frame, associations);
  ASSERT_EQ(window.frames().front().boxes.size(), 1u);
  EXPECT_EQ(window.frames().front().boxes.front().landmark_id, 4);
}

TEST(Spheroid, DerivativesAgreeWithDifferences) {
  std::mt19937_64 random(4);
  constexpr double kStep = 1e-6;
  for (int trial = 0; trial < 50; ++trial) {
    const Vec3 center(uniform(random, -0.5, 0.5), uniform(random, -0.5, 0.5), uniform(random, 0.8, 3.0));
    const Vec3 axis = Vec3(uniform(random, -1, 1), uniform(random, -1, 1), uniform(random, -1, 1)).normalized();
    const Vec2 log_axes(std::log(uniform(random, 0.05, 0.3)), std::log(uniform(random, 0.05, 0.3)));
    const auto at = project_spheroid(center, axis, log_axes);
    ASSERT_TRUE(at.has_value());
    const auto box = spheroid_box(center, axis, log_axes);
    EXPECT_LT((box->edges() - at->edges).norm(), 1e-12);
    for (int i = 0; i < 3; ++i) {
      const Vec3 step = kStep * Vec3::Unit(i);
      const Vec4 by_center = (project_spheroid(center + step, axis, log_axes)->edges -
                              project_spheroid(center - step, axis, log_axes)->edges) /
                             (2 * kStep);
      const Vec4 by_axis = (project_spheroid(center, axis + step, log_axes)->edges -
                            project_spheroid(center, axis - step, log_axes)->edges) /
                           (2 * kStep);
      EXPECT_LT((by_center - at->d_center.col(i)).norm(), 1e-6);
      EXPECT_LT((by_axis - at->d_axis.col(i)).norm(), 1e-6);
    }
    for (int i = 0; i < 2; ++i) {
      const Vec2 step = kStep * Vec2::Unit(i);
      const Vec4 by_axes = (project_spheroid(center, axis, log_axes + step)->edges -
                            project_spheroid(center, axis, log_axes - step)->edges) /
                           (2 * kStep);
      EXPECT_LT((by_axes - at->d_log_axes.col(i)).norm(), 1e-6);
    }
  }
}

TEST(Spheroid, BehindTheCameraIsNothing) {
  EXPECT_FALSE(project_spheroid(Vec3(0, 0, -1), Vec3::UnitY(), Vec2(-2, -2)).has_value());
  EXPECT_FALSE(spheroid_box(Vec3(0, 0, 0.05), Vec3::UnitY(), Vec2(-2, -2)).has_value());
}

std::vector<NodePair> true_pairs(const BuiltMap& a, const BuiltMap& b) {
  const SE3 T_a_b = a.T_world_anchor.inverse() * b.T_world_anchor;
  std::vector<NodePair> pairs;
  for (int i = 0; i < static_cast<int>(a.map.objects.size()); ++i) {
    for (int j = 0; j < static_cast<int>(b.map.objects.size()); ++j) {
      const LocalObject& p = a.map.object(i);
      const LocalObject& q = b.map.object(j);
      if (p.label == q.label && (p.spheroid.center - T_a_b * q.spheroid.center).norm() < 0.06) pairs.push_back({i, j});
    }
  }
  return pairs;
}

TEST(SubmapRefiner, RemovesAnErrorAndStatesItsCovariance) {
  const auto desk = random_desk(1, 12);
  const BuiltMap a = sweep(desk, 0.0, 60.0, 5), b = sweep(desk, 50.0, 110.0, 6);
  const SE3 truth = a.T_world_anchor.inverse() * b.T_world_anchor;
  Vec6 error;
  error << 0.05, -0.06, 0.04, 0.03, 0.04, -0.02;
  const auto refined = refine_submaps(a.map, b.map, truth * se3_exp(error), true_pairs(a, b), LoopOptions());
  ASSERT_TRUE(refined.has_value());
  const Vec6 left = se3_log(truth.inverse() * refined->T_a_b);
  EXPECT_LT(left.head<3>().norm(), 0.025);
  EXPECT_LT(left.tail<3>().norm(), radians(1.0));
  EXPECT_LT(refined->median_residual, 1.0);
  EXPECT_LT(left.dot(refined->covariance.ldlt().solve(left)), 30.0);
  EXPECT_LT(refined->covariance.diagonal().head<3>().maxCoeff(), 0.05 * 0.05);
  EXPECT_GT(refined->covariance.diagonal().head<3>().minCoeff(), 0.001 * 0.001);
}

TEST(SubmapRefiner, ThicknessOfThingsSeenFromTwoSidesDoesNotMoveThePose) {
  const auto desk = random_desk(1, 12);
  const auto thick = [&desk](const SE3& pose, Association* seen) { seen->near_m = near_m(desk, pose, *seen) - 0.03; };
  const BuiltMap a = sweep(desk, 0.0, 60.0, 5, thick), b = sweep(desk, 100.0, 160.0, 6, thick);
  const SE3 truth = a.T_world_anchor.inverse() * b.T_world_anchor;
  LoopOptions options;
  std::vector<NodePair> pairs = true_pairs(a, b);
  ASSERT_GE(pairs.size(), 6U);
  ASSERT_GT(a.map.objects[0].views[0].depth_m, 0.0);
  Vec6 error;
  error << 0.05, -0.06, 0.04, 0.03, 0.04, -0.02;
  const auto refined = refine_submaps(a.map, b.map, truth * se3_exp(error), pairs, options);
  ASSERT_TRUE(refined.has_value());
  const Vec6 left = se3_log(truth.inverse() * refined->T_a_b);
  EXPECT_LT(left.head<3>().norm(), 0.02);
  EXPECT_LT(left.tail<3>().norm(), radians(1.0));
  options.use_points = false;
  const auto by_boxes = refine_submaps(a.map, b.map, truth * se3_exp(error), pairs, options);
  ASSERT_TRUE(by_boxes.has_value());
  EXPECT_GT(by_boxes->covariance.trace(), refined->covariance.trace()) << "depth tells something";
}

TEST(SubmapRefiner, RefusesWhatCannotBeSolved) {
  const auto desk = random_desk(1, 12);
  const BuiltMap a = sweep(desk, 0.0, 60.0, 5), b = sweep(desk, 50.0, 110.0, 6);
  const SE3 truth = a.T_world_anchor.inverse() * b.T_world_anchor;
  EXPECT_FALSE(refine_submaps(a.map, b.map, truth, {}, LoopOptions()).has_value());
  SE3 broken = truth;
  broken.t.x() = std::nan("");
  EXPECT_FALSE(refine_submaps(a.map, b.map, broken, true_pairs(a, b), LoopOptions()).has_value());
}

/// A wall that the anchor looks at.
std::shared_ptr<const std::vector<Surfel>> wall_at(float depth_m) {
  auto surfels = std::make_shared<std::vector<Surfel>>();
  for (int i = -20; i <= 20; ++i) {
    for (int j = -20; j <= 20; ++j) {
      const Eigen::Vector3f position(0.03F * static_cast<float>(i), 0.03F * static_cast<float>(j), 1.0F);
      surfels->push_back({depth_m * position, -Eigen::Vector3f::UnitZ()});
    }
  }
  return surfels;
}

TEST(SubmapRefiner, ALoopThatSurfacesContradictIsRefusedWithThatReason) {
  const auto desk = random_desk(1, 12);
  BuiltMap a = sweep(desk, 0.0, 60.0, 5), b = sweep(desk, 50.0, 110.0, 6);
  GraphMatch match;
  match.T_a_b = a.T_world_anchor.inverse() * b.T_world_anchor;
  match.pairs = true_pairs(a, b);
  const LoopOptions options;
  const auto decide = [&] {
    LoopClosure loop = make_closure(a.map, b.map);
    refine_and_decide(a.map, b.map, match, false, options, &loop);
    return loop;
  };
  const LoopClosure by_boxes = decide();
  EXPECT_EQ(by_boxes.reason, LoopReason::kAccepted);
  a.map.surfels = wall_at(0.6F);
  EXPECT_EQ(decide().T_match_query.t, by_boxes.T_match_query.t) << "one side alone says nothing";
  b.map = a.map;  // the same place, where the wall has gone
  b.map.surfels = wall_at(3.0F);
  match.T_a_b = SE3();
  match.pairs.clear();
  for (int i = 0; i < static_cast<int>(a.map.objects.size()); ++i) match.pairs.push_back({i, i});
  EXPECT_EQ(decide().reason, LoopReason::kContradicted);
  EXPECT_FALSE(decide().accepted);
  b.map.surfels.reset();
  EXPECT_EQ(decide().reason, LoopReason::kAccepted);
}

/// A submap, itself once more, and four objects that are the same in both.
struct FourObjects {
  LocalMap match = sweep(random_desk(1, 12), 0.0, 60.0, 5).map, query = match;
  GraphMatch alignment;

  FourObjects() {
    for (int i = 0; i < 4; ++i) alignment.pairs.push_back({i, i});
  }
};

TEST(SubmapRefiner, FewObjectsSufficeWhereSurfacesConfirmThem) {
  FourObjects seen;
  LocalMap &match = seen.match, &query = seen.query;
  GraphMatch& alignment = seen.alignment;
  alignment.classes = 3;
  alignment.score = 9.0;
  alignment.spread_m = Vec3(0.5, 0.3, 0.05);
  const LoopOptions options;
  const auto verify = [&] { return verify_alignment(match, query, alignment, 2.0, options).reason; };
  const auto decide = [&] {
    LoopClosure loop = make_closure(match, query);
    set_alignment(match, query, alignment, &loop);
    refine_and_decide(match, query, alignment, true, options, &loop);
    return loop.reason;
  };
  EXPECT_EQ(verify(), LoopReason::kTooFewInliers);
  match.surfels = query.surfels = wall_at(0.8F);
  EXPECT_EQ(verify(), LoopReason::kAccepted);
  EXPECT_EQ(decide(), LoopReason::kAccepted);
  query.surfels = wall_at(3.0F);
  EXPECT_EQ(decide(), LoopReason::kContradicted);
  query.surfels = std::make_shared<const std::vector<Surfel>>();
  EXPECT_EQ(decide(), LoopReason::kTooFewInliers) << "surfaces that do not meet confirm nothing";
}

TEST(SubmapRefiner, PointsThatBothSubmapsShowSayThePose) {
  FourObjects seen;
  LocalMap &match = seen.match, &query = seen.query;
  GraphMatch& alignment = seen.alignment;
  std::mt19937_64 random(3);
  const auto uniform = [&random] { return 2.0F * static_cast<float>(random() % 1000) / 1000.0F - 1.0F; };
  std::vector<PointFeature> points(60);
  for (PointFeature& point : points) {
    point.position = Eigen::Vector3f(uniform(), uniform(), 2.0F + 0.5F * uniform());
    for (std::uint64_t& word : point.descriptor) word = random();
  }
  match.features = std::make_shared<const std::vector<PointFeature>>(points);
  // What the boxes alone cannot tell.
  const Eigen::Vector3f shift(0.03F, 0.0F, 0.01F);
  for (PointFeature& point : points) point.position += shift;
  query.features = std::make_shared<const std::vector<PointFeature>>(points);
  const LoopOptions options;
  const auto decide = [&] {
    LoopClosure loop = make_closure(match, query);
    refine_and_decide(match, query, alignment, true, options, &loop);
    return loop;
  };
  const LoopClosure loop = decide();
  EXPECT_EQ(loop.reason, LoopReason::kAccepted) << "few objects suffice";
  EXPECT_LT((loop.T_match_query.t + shift.cast<double>()).norm(), 0.002);
  EXPECT_LT(loop.sigma_m, 0.02);
  match.surfels = wall_at(0.8F);
  query.surfels = wall_at(3.0F);
  EXPECT_EQ(decide().reason, LoopReason::kContradicted) << "for all that looks alike";
  LoopClosure by_points = make_closure(match, query);
  decide_by_points(match, query, &by_points);
  EXPECT_EQ(by_points.reason, LoopReason::kContradicted);
  EXPECT_FALSE(by_points.accepted);
  match.surfels = query.surfels = nullptr;
  query.features = nullptr;
  EXPECT_EQ(decide().reason, LoopReason::kTooFewInliers);
}

TEST(LoopVerifier, AcceptsTheTruthAndTellsWhatFails) {
  const auto desk = random_desk(1, 12);
  const BuiltMap a = sweep(desk, 0.0, 60.0, 5), b = sweep(desk, 50.0, 110.0, 6);
  const LoopOptions options;
  GraphMatch match;
  match.T_a_b = a.T_world_anchor.inverse() * b.T_world_anchor;
  match.pairs = true_pairs(a, b);
  match.classes = 5;
  match.score = 9.0;
  match.rms_m = 0.02;
  match.spread_m = Vec3(0.5, 0.3, 0.05);
  ASSERT_GE(match.pairs.size(), 7u);
  EXPECT_EQ(verify_alignment(a.map, b.map, match, 2.0, options).reason, LoopReason::kAccepted);
  EXPECT_EQ(verify_alignment(a.map, b.map, match, 8.0, options).reason, LoopReason::kAmbiguous);

  GraphMatch changed = match;
  changed.classes = 2;
  EXPECT_EQ(verify_alignment(a.map, b.map, changed, 2.0, options).reason, LoopReason::kTooFewLabels);
  changed = match;
  changed.spread_m = Vec3(0.5, 0.01, 0.0);
  EXPECT_EQ(verify_alignment(a.map, b.map, changed, 2.0, options).reason, LoopReason::kDegenerate);
  changed = match;
  changed.rms_m = 0.2;
  EXPECT_EQ(verify_alignment(a.map, b.map, changed, 2.0, options).reason, LoopReason::kResidual);
  changed = match;
  changed.pairs.resize(5);
  EXPECT_EQ(verify_alignment(a.map, b.map, changed, 2.0, options).reason, LoopReason::kTooFewInliers);
  LocalMap askew = b.map;
  askew.up.direction = so3_exp(radians(25.0) * askew.up.direction.unitOrthogonal()) * askew.up.direction;
  ASSERT_TRUE(a.map.up.certain && askew.up.certain);
  EXPECT_EQ(verify_alignment(a.map, askew, match, 2.0, options).reason, LoopReason::kTilt);
  askew.up.certain = false;
  EXPECT_NE(verify_alignment(a.map, askew, match, 2.0, options).reason, LoopReason::kTilt);
  changed = match;
  const Vec3 up = a.map.up.direction;
  const Vec3 middle = match.T_a_b * b.map.objects.front().spheroid.center;
  const SE3 turn(so3_exp(radians(90.0) * up), middle - so3_exp(radians(90.0) * up) * middle);
  changed.T_a_b = turn * match.T_a_b;
  EXPECT_NE(verify_alignment(a.map, b.map, changed, 2.0, options).reason, LoopReason::kAccepted);
}

TEST(LoopVerifier, RejectsAMirroredWorld) {
  constexpr double kMaxRms_m = 0.09;
  // All centres in one plane: a half turn about an axis in the plane puts them onto their own mirror image.
  LocalMap a;
  a.frames.resize(1);
  a.frames[0].position = Vec3(0.1, 0.2, -1.5);
  for (int i = 0; i < 8; ++i) {
    LocalObject object;
    object.spheroid.center = Vec3(0.2 * i, 0.05 * i * i, 0.0);
    a.objects.push_back(object);
  }
  LocalMap b = a;
  for (LocalObject& object : b.objects) object.spheroid.center.y() *= -1.0;
  GraphMatch match;
  match.T_a_b = SE3(so3_exp(Vec3(kPi, 0, 0)), Vec3::Zero());
  for (int i = 0; i < 8; ++i) match.pairs.push_back({i, i});
  EXPECT_TRUE(is_mirrored(a, b, match, kMaxRms_m));
  LocalMap deep_a = a, deep_b = b;
  for (std::size_t i = 0; i < a.objects.size(); i += 2) {
    deep_a.objects[i].spheroid.center.z() += 0.4;
    deep_b.objects[i].spheroid.center.z() -= 0.4;
  }
  EXPECT_FALSE(is_mirrored(deep_a, deep_b, match, kMaxRms_m)) << "a mirror image would not fit";
  GraphMatch same = match;
  same.T_a_b = SE3();
  EXPECT_FALSE(is_mirrored(a, a, same, kMaxRms_m));
  // No residual shows it: all that is said of the match is perfect.
  for (GraphMatch* perfect : {&match, &same}) {
    perfect->classes = 5;
    perfect->score = 8.0;
    perfect->spread_m = Vec3(0.5, 0.3, 0.0);
  }
  const LoopOptions options;
  EXPECT_EQ(verify_alignment(a, b, match, 0.0, options).reason, LoopReason::kMirrored);
  EXPECT_NE(verify_alignment(a, a, same, 0.0, options).reason, LoopReason::kMirrored);
}

TEST(LoopVerifier, ComparesUpDirectionsOnlyWhenCertain) {
  LocalMap a, b;
  a.up = {Vec3::UnitY(), true};
  b.up = {Vec3::UnitZ(), true};
  EXPECT_NEAR(tilt(a, b, SE3()), kPi / 2, 1e-9);
  b.up.certain = false;
  EXPECT_EQ(tilt(a, b, SE3()), 0.0);
}

constexpr std::int64_t kFrameNs = 33'000'000;

ObservedBox box_at(double x, double y, int class_id = 1, double size = 0.1) {
  ObservedBox box;
  box.class_id = class_id;
  box.box = {x - 0.5 * size, y - 0.5 * size, x + 0.5 * size, y + 0.5 * size};
  return box;
}

void follow(BoxTracker* tracker, std::int64_t stamp_ns, const Quaternion& q_odom_camera,
            std::vector<ObservedBox>* boxes) {
  tracker->follow(stamp_ns, q_odom_camera, std::vector<double>(boxes->size(), 0.9), boxes);
}

/// A box about the direction of a point, seen by a camera of that rotation.
ObservedBox box_of(const Vec3& point, const Quaternion& q_world_camera, int class_id = 1) {
  const Vec3 p = q_world_camera.conjugate() * point;
  return box_at(p.x() / p.z(), p.y() / p.z(), class_id);
}

TEST(BoxTracker, FollowsThroughTurnsAndGaps) {
  BoxTracker tracker;
  std::int64_t first = -1, second = -1;
  for (int k = 0; k < 40; ++k) {
    const Quaternion q = so3_exp(Vec3(0.01 * k, -0.03 * k, 0.0));  // 50 deg a second: half a box from frame to frame
    std::vector<ObservedBox> boxes = {box_of(Vec3(-0.5, 0.0, 2.0), q), box_of(Vec3(0.4, 0.1, 2.0), q, 2)};
    if (k % 10 >= 4 && k % 10 < 8) boxes.pop_back();
    follow(&tracker, k * kFrameNs, q, &boxes);
    if (k == 0) first = boxes[0].track_id;
    if (k == 0) second = boxes[1].track_id;
    EXPECT_EQ(boxes[0].track_id, first) << k;
    if (boxes.size() > 1) {
      EXPECT_EQ(boxes[1].track_id, second) << k;
    }
  }
  EXPECT_NE(first, second);
}

TEST(BoxTracker, TheCommonestClassIsTheTracks) {
  BoxTracker tracker;
  std::vector<ObservedBox> boxes;
  for (int k = 0; k < 10; ++k) {
    boxes = {box_at(0.0, 0.0, k % 3 == 2 ? 5 : 7)};
    follow(&tracker, k * kFrameNs, Quaternion::Identity(), &boxes);
    EXPECT_EQ(boxes[0].track_id, 0);
    EXPECT_EQ(boxes[0].class_id, 7);
  }
}

TEST(BoxTracker, TakesTheBoxThatOverlapsMost) {
  BoxTracker tracker;
  std::vector<ObservedBox> boxes = {box_at(0.0, 0.0), box_at(0.07, 0.0)};
  follow(&tracker, 0, Quaternion::Identity(), &boxes);
  std::vector<ObservedBox> next = {box_at(0.075, 0.0), box_at(0.005, 0.0)};
  follow(&tracker, kFrameNs, Quaternion::Identity(), &next);
  EXPECT_EQ(next[0].track_id, boxes[1].track_id);
  EXPECT_EQ(next[1].track_id, boxes[0].track_id);
}

TEST(BoxTracker, FollowsASlowDetectorThroughOneMissedAnswer) {
  BoxTracker tracker;
  for (const int second : {0, 1, 2, 3, 5, 6}) {
    std::vector<ObservedBox> boxes = {box_at(0.0, 0.0)}, none;
    if (second == 5) follow(&tracker, 4'000'000'000, Quaternion::Identity(), &none);
    follow(&tracker, second * 1'000'000'000LL, Quaternion::Identity(), &boxes);
    EXPECT_EQ(boxes[0].track_id, 0) << second;
  }
}

TEST(BoxTracker, EndsTracksAfterAWhileAndWhenTold) {
  BoxTracker tracker;
  std::vector<ObservedBox> boxes = {box_at(0.0, 0.0)}, later = boxes, last = boxes, none;
  follow(&tracker, 0, Quaternion::Identity(), &boxes);
  for (const std::int64_t stamp_ns : {300'000'000, 600'000'000})
    follow(&tracker, stamp_ns, Quaternion::Identity(), &none);
  follow(&tracker, 1'000'000'000, Quaternion::Identity(), &later);
  EXPECT_NE(later[0].track_id, boxes[0].track_id);
  tracker.clear();
  follow(&tracker, 1'000'000'000 + kFrameNs, Quaternion::Identity(), &last);
  EXPECT_NE(last[0].track_id, later[0].track_id);
  follow(&tracker, 2'000'000'000, Quaternion::Identity(), &none);
  EXPECT_TRUE(none.empty());
}

const Camera kCamera{525.0, 525.0, 320.0, 240.0, 640, 480, {}};

/// A camera 0.8 m over the table that looks down by `pitch_deg` and rolls by `roll_deg`.
SE3 pose_at(double yaw_deg, double pitch_deg, double roll_deg) {
  const auto turn = [](double deg, const Vec3& axis) { return Quaternion(Eigen::AngleAxisd(radians(deg), axis)); };
  Mat3 level;  // x right, y down, z forward, of a camera that looks along the world's x
  level << 0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0;
  const Quaternion q = turn(yaw_deg, Vec3::UnitZ()) * Quaternion(level) * turn(-pitch_deg, Vec3::UnitX()) *
                       turn(roll_deg, Vec3::UnitZ());
  return {q, Vec3(-0.9, 0.1, 0.8)};
}

Frame frame_at(int k, const SE3& pose, std::shared_ptr<const std::vector<Vec3>> points) {
  Frame frame;
  frame.frame_id = k;
  frame.stamp_ns = k * 100'000'000LL;
  frame.T_odom_camera = pose;
  frame.camera = kCamera;
  frame.points_camera = std::move(points);
  return frame;
}

double error_deg(const UpDirection& up, const SE3& pose) {
  return degrees(std::acos(std::min(1.0, (pose.q * up.direction).z())));
}

TEST(UpEstimator, ATableTellsUpToACameraThatHardlyTurnsAndIsHeldAskew) {
  const DepthScene scene{{on_table(0.0, 0.0, Vec3(0.1, 0.1, 0.1)), on_table(0.2, 0.3, Vec3(0.06, 0.2, 0.18))}};
  UpEstimator with_points(33.0), without(33.0);
  SE3 pose;
  for (int k = 0; k < 12; ++k) {
    pose = pose_at(k % 3, 40.0 + k % 4, 6.0);
    const auto points = std::make_shared<const std::vector<Vec3>>(scene.look(kCamera, pose, 1 + k));
    with_points.push(frame_at(k, pose, points));
    without.push(frame_at(k, pose, nullptr));
  }
  const UpDirection up = with_points.estimate(pose.q);
  EXPECT_TRUE(up.certain);
  EXPECT_LT(error_deg(up, pose), 1.0);
  EXPECT_FALSE(without.estimate(pose.q).certain);
  Frame broken = frame_at(13, pose, nullptr);
  broken.is_break = true;
  with_points.push(broken);
  EXPECT_FALSE(with_points.estimate(pose.q).certain) << "what was before a break is of another frame";
}

TEST(UpEstimator, TellsHowFarACameraIsRolledThatHasLookedAroundWithoutRoll) {
  UpEstimator up(33.0);
  SE3 pose;
  for (int k = 0; k < 12; ++k) {
    pose = pose_at(8.0 * k, 30.0, 0.0);
    up.push(frame_at(k, pose, nullptr));
  }
  EXPECT_NEAR(up.roll_rad(pose.q), 0.0, 1e-6);
  for (const double roll_deg : {-120.0, -40.0, 40.0, 170.0}) {
    // Clockwise as it sees: its x axis turns towards its y axis.
    const Quaternion rolled = pose.q * so3_exp(Vec3(0.0, 0.0, radians(roll_deg)));
    EXPECT_NEAR(up.roll_rad(rolled), radians(roll_deg), 1e-6);
    const Vec3 up_camera = rolled.conjugate() * Vec3::UnitZ();
    EXPECT_GT(std::sin(radians(roll_deg)) * -up_camera.x(), 0.0);
  }
  EXPECT_EQ(up.roll_rad(pose_at(0.0, 80.0, 0.0).q * so3_exp(Vec3(0.0, 0.0, 1.0))), 0.0) << "it looks down";
  EXPECT_EQ(UpEstimator(33.0).roll_rad(pose.q), 0.0);
}

TEST(UpEstimator, ATableTellsUpToACameraThatIsRolledAfterItWasHeldUpright) {
  const Ellipsoid wall{SE3(Quaternion::Identity(), Vec3(1.3, 0.0, 0.0)), Vec3(0.02, 5.0, 5.0)};
  const DepthScene scene{{on_table(0.0, 0.0, Vec3(0.1, 0.1, 0.1)), wall}};
  UpEstimator up(10.0);
  for (int k = 0; k < 160; ++k) {
    const SE3 pose = pose_at(8.0 * std::sin(k), 30.0, 170.0 * std::sin(radians(4.5 * k)));
    up.push(frame_at(k, pose, std::make_shared<const std::vector<Vec3>>(scene.look(kCamera, pose, 1 + k))));
    if (k < 5) continue;
    ASSERT_TRUE(up.estimate(pose.q).certain) << k;
    ASSERT_LT(error_deg(up.estimate(pose.q), pose), 2.0) << k;
  }
}

TEST(UpEstimator, WhereACameraThatOnlyRollsLooksIsNotUp) {
  UpEstimator up(33.0);
  SE3 pose;
  for (int k = 0; k < 160; ++k) {
    pose = pose_at(2.0 * std::sin(k), 20.0, 80.0 * std::sin(radians(4.5 * k)));
    up.push(frame_at(k, pose, nullptr));
    ASSERT_FALSE(up.estimate(pose.q).certain) << k;
  }
  EXPECT_LT(error_deg(up.estimate(pose.q), pose), 40.0) << "image-up, on the average";
}

TEST(UpEstimator, AWallIsNotTakenForAFloor) {
  UpEstimator up(33.0);
  auto wall = std::make_shared<std::vector<Vec3>>();
  for (int i = -20; i <= 20; ++i) {
    for (int j = -15; j <= 15; ++j) wall->push_back({0.05 * i, 0.05 * j, 2.0});
  }
  const SE3 pose = pose_at(0.0, 0.0, 0.0);
  for (int k = 0; k < 12; ++k) up.push(frame_at(k, pose, wall));
  EXPECT_FALSE(up.estimate(pose.q).certain);
}

TEST(UpEstimator, WithoutUsefulPointsItIsAsWithoutPoints) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  UpEstimator with_points(33.0), without(33.0);
  SE3 pose;
  for (int k = 0; k < 200; ++k) {
    pose = pose_at(0.6 * k, 30.0, 3.0 * std::sin(k));
    const std::vector<Vec3> points(k % 2 == 0 ? 0 : 30, k % 3 == 0 ? Vec3(nan, nan, nan) : Vec3(0.0, 0.0, -1.0));
    with_points.push(frame_at(k, pose, std::make_shared<const std::vector<Vec3>>(points)));
    without.push(frame_at(k, pose, nullptr));
  }
  EXPECT_EQ(with_points.estimate(pose.q).certain, without.estimate(pose.q).certain);
  EXPECT_EQ(with_points.estimate(pose.q).direction, without.estimate(pose.q).direction);
}

/// Feeds a sweep around a desk to a monitor whose reference is the submap of the last window.
struct Watch {
  double drift_deg_s = 0.0;  ///< the odometry tilts
  SE3 jump;                  ///< of the odometry at 14 s
  std::optional<double> drift_rad_s;
  std::vector<double> jumps_s;

  void run() {
    const LoopOptions options;
    const auto desk = testing::random_desk(3, 12);
    ObservationWindow window(8.0, options.frame_interval_s, *testing::desk_classes());
    UpEstimator up(options.up_window_s);
    FrameBuilder builder(KeyframeOptions(), testing::desk_camera());
    OdometryMonitor monitor(LoopOptions().max_depth_m);
    std::mt19937_64 random(5);
    for (std::int64_t k = 0; k < 200; ++k) {
      const double time_s = 0.1 * static_cast<double>(k);
      const SE3 pose = testing::desk_pose({{0.0, 20.0, 0.0, 120.0}}, time_s);
      const SE3 turn(so3_exp(Vec3(radians(drift_deg_s * time_s), 0.0, 0.0)), Vec3::Zero());
      const auto frame = builder.build({k * 100'000'000, (time_s < 14.0 ? SE3() : jump) * turn * pose});
      window.push(*frame, testing::observe(desk, *frame, pose, 0, random));
      up.push(*frame);
      if (monitor.push(window.frames().back())) {
        jumps_s.push_back(time_s);
        window.clear();
      }
      const auto map = k % 3 == 0 ? build_local_map(window.frames(), LandmarkRedirects(), up, options) : std::nullopt;
      if (map) monitor.set_reference(*map);
    }
    drift_rad_s = monitor.drift_rad_s();
  }
};

TEST(OdometryMonitor, MeasuresDrift) {
  Watch good, poor;
  poor.drift_deg_s = 0.6;
  good.run();
  poor.run();
  ASSERT_TRUE(good.drift_rad_s && poor.drift_rad_s);
  EXPECT_TRUE(good.jumps_s.empty());
  EXPECT_TRUE(poor.jumps_s.empty());
  EXPECT_LT(*good.drift_rad_s, 0.002);
  EXPECT_GT(*poor.drift_rad_s, 2.0 * *good.drift_rad_s);
}

TEST(OdometryMonitor, NoticesAJump) {
  Watch watch;
  watch.jump = SE3(so3_exp(Vec3(0.0, 0.0, radians(8.0))), Vec3(0.1, 0.0, 0.0));
  watch.run();
  ASSERT_EQ(watch.jumps_s.size(), 1u);
  EXPECT_NEAR(watch.jumps_s.front(), 14.2, 0.3);
}

TEST(OdometryMonitor, NoticesAJumpInACrowd) {
  // A wall of pictures, of which each moves by less than half the way to the next.
  LocalMap wall;
  ObservedFrame in_place, moved;
  in_place.stamp_ns = moved.stamp_ns = 100'000'000;
  const Vec2 shift(0.03, 0.05);
  for (int i = 0; i < 400; ++i) {
    const Vec2 at(0.12 * (i % 20) - 1.2, 0.12 * (i / 20) - 1.2);
    const double radius_m = 0.05 + 0.0001 * i;
    LocalObject object;
    object.label = 0;
    object.spheroid.center = 2.0 * at.homogeneous();
    object.spheroid.log_axes = Vec2::Constant(std::log(radius_m));
    wall.objects.push_back(object);
    ObservedBox box;
    box.label = 0;
    const auto box_at = [radius_m](const Vec2& center) {
      const double half = 0.5 * radius_m;
      return Box{center.x() - half, center.y() - half, center.x() + half, center.y() + half};
    };
    box.box = box_at(at);
    in_place.boxes.push_back(box);
    box.box = box_at(at + shift);
    moved.boxes.push_back(box);
  }
  OdometryMonitor monitor(LoopOptions().max_depth_m);
  monitor.set_reference(wall);
  for (int k = 0; k < 3; ++k) EXPECT_FALSE(monitor.push(in_place));
  EXPECT_FALSE(monitor.push(moved)) << "one frame is none";
  EXPECT_TRUE(monitor.push(moved));
}

TEST(OdometryMonitor, RefutesAJumpWhoseObjectsStandWhereTheyDid) {
  LocalMap map;
  for (int i = 0; i < 4; ++i) {
    LocalObject object;
    object.label = i;
    object.spheroid.center = Vec3(0.3 * i - 0.5, 0.1 * i, 2.0);
    object.spheroid.log_axes = Vec2::Constant(std::log(0.1));
    map.objects.push_back(object);
  }
  Vec6 jump;
  jump << 0.1, 0.0, 0.0, 0.0, radians(5.0), 0.0;
  const SE3 moved(so3_exp(jump.tail<3>()), jump.head<3>());
  OdometryMonitor monitor(LoopOptions().max_depth_m);
  monitor.set_reference(map);
  const auto seen_from = [&map](const SE3& T_odom_camera, std::size_t count) {
    ObservedFrame frame;
    for (std::size_t i = 0; i < count; ++i) {
      const LocalObject& object = map.objects[i];
      const Vec3 p = T_odom_camera.inverse() * object.spheroid.center;
      const Vec2 at = p.head<2>() / p.z(), half = Vec2::Constant(0.1 / p.z());
      ObservedBox box;
      box.label = object.label;
      box.box = {at.x() - half.x(), at.y() - half.y(), at.x() + half.x(), at.y() + half.y()};
      frame.boxes.push_back(box);
    }
    return frame;
  };
  ObservedFrame jolted = seen_from(moved, 4), jumped = seen_from(SE3(), 4), one = seen_from(moved, 1);
  for (ObservedFrame* frame : {&jolted, &jumped, &one}) frame->T_odom_camera = moved;
  EXPECT_TRUE(monitor.refutes(jump, jolted)) << "the camera moved";
  EXPECT_FALSE(monitor.refutes(jump, jumped)) << "the odometry alone did";
  EXPECT_FALSE(monitor.refutes(jump, one)) << "one object may be anywhere";
  monitor.restart();
  EXPECT_FALSE(monitor.refutes(jump, jolted)) << "there is nothing to tell by";
}

TEST(OdometryMonitor, SaysNothingWithoutAReference) {
  OdometryMonitor monitor(LoopOptions().max_depth_m);
  EXPECT_FALSE(monitor.push(ObservedFrame()));
  EXPECT_FALSE(monitor.drift_rad_s().has_value());
}

}  // namespace
}  // namespace semantic_topo_loop::core
