#include "loop/submap/feature_alignment.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <cstdint>
#include <deque>
#include <memory>
#include <random>
#include <vector>

#include "geometry/depth_points.h"
#include "geometry/descriptor.h"
#include "loop/graph/graph_detector.h"
#include "loop/submap/observation_window.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/loop/loop_options.h"

namespace semantic_topo_loop::core {
namespace {

using Features = std::vector<PointFeature>;

Vec3 random_vector(double size, std::mt19937_64* random) {
  std::normal_distribution<double> normal;
  return size / std::sqrt(3.0) * Vec3(normal(*random), normal(*random), normal(*random));
}

Descriptor random_descriptor(std::mt19937_64* random) {
  Descriptor descriptor{};
  for (std::uint64_t& word : descriptor) word = (*random)();
  return descriptor;
}

/// What another view makes of it.
Descriptor seen_again(Descriptor descriptor, int bits, std::mt19937_64* random) {
  for (int i = 0; i < bits; ++i) descriptor[(*random)() % descriptor.size()] ^= std::uint64_t{1} << (*random)() % 64;
  return descriptor;
}

/// Points some metres before a camera.
Features scene(std::size_t count, std::mt19937_64* random) {
  Features features;
  for (std::size_t i = 0; i < count; ++i) {
    const Vec3 position = Vec3(0.0, 0.0, 2.0) + random_vector(1.0, random);
    features.push_back({static_cast<std::int64_t>(i), position.cast<float>(), random_descriptor(random)});
  }
  return features;
}

/// What a submap has of a scene.
LocalMap submap_of(const Features& scene, const SE3& T_local_scene, std::mt19937_64* random) {
  std::normal_distribution<double> normal;
  Features features;
  for (const PointFeature& point : scene) {
    const Vec3 local = T_local_scene * point.position.cast<double>();
    const Vec3 noise = 0.002 * Vec3(normal(*random), normal(*random), normal(*random)) +
                       depth_sigma_m(local.norm()) * normal(*random) * local.normalized();
    features.push_back({point.id, (local + noise).cast<float>(), seen_again(point.descriptor, 20, random)});
  }
  LocalMap map;
  map.features = std::make_shared<const Features>(features);
  return map;
}

SE3 random_pose(double translation_m, double rotation_rad, std::mt19937_64* random) {
  Vec6 motion;
  motion << random_vector(translation_m, random), random_vector(rotation_rad, random);
  return se3_exp(motion);
}

/// As many points that both submaps show, and points that one alone shows.
struct Meeting {
  LocalMap a, b;
  SE3 truth;  ///< T_a_b
};

Meeting meeting(std::size_t common, std::size_t others, std::mt19937_64* random) {
  const Features shared = scene(common, random);
  Meeting result;
  result.truth = random_pose(0.5, 0.3, random);
  Features in_a = scene(others, random), in_b = scene(others, random);
  in_a.insert(in_a.end(), shared.begin(), shared.end());
  in_b.insert(in_b.end(), shared.begin(), shared.end());
  result.a = submap_of(in_a, SE3(), random);
  result.b = submap_of(in_b, result.truth.inverse(), random);
  return result;
}

TEST(FeatureAlignment, PointsGiveThePoseAndItsCovariance) {
  double nees = 0.0;
  constexpr int kSeeds = 20;
  for (int seed = 0; seed < kSeeds; ++seed) {
    std::mt19937_64 random(static_cast<std::uint64_t>(seed));
    const Meeting both = meeting(60, 200, &random);
    const SE3 start = both.truth * random_pose(0.15, 0.08, &random);
    const auto aligned = align_features(both.a, both.b, start);
    ASSERT_TRUE(aligned.has_value()) << seed;
    EXPECT_GE(aligned->points, 35) << seed;
    EXPECT_LE(aligned->points, 60) << seed;
    const Vec6 error = se3_log(both.truth.inverse() * aligned->T_a_b);
    EXPECT_LT(error.head<3>().norm(), 0.01) << seed;
    EXPECT_LT(error.tail<3>().norm(), radians(0.4)) << seed;
    nees += error.dot(aligned->covariance.ldlt().solve(error)) / kSeeds;
    const auto again = align_features(both.a, both.b, start);
    EXPECT_TRUE(again->T_a_b.t == aligned->T_a_b.t && again->T_a_b.q.coeffs() == aligned->T_a_b.q.coeffs());
  }
  // Six where it is true. How a submap is bent, of which there is nothing here, is in the statement.
  EXPECT_GT(nees, 0.05);
  EXPECT_LT(nees, 6.0);
}

TEST(FeatureAlignment, WhatLooksAlikeButIsElsewhereDoesNotCount) {
  std::mt19937_64 random(3);
  Meeting both = meeting(60, 100, &random);
  // Two thirds of what both show has been moved, each thing to another place.
  Features moved = *both.b.features;
  for (std::size_t i = moved.size() - 40; i < moved.size(); ++i) {
    moved[i].position += random_vector(0.25, &random).cast<float>();
  }
  both.b.features = std::make_shared<const Features>(moved);
  const auto aligned = align_features(both.a, both.b, both.truth);
  ASSERT_TRUE(aligned.has_value());
  EXPECT_LT(aligned->points, 30);
  EXPECT_LT((both.truth.inverse() * aligned->T_a_b).t.norm(), 0.015);
}

TEST(FeatureAlignment, TooFewPointsSayNothing) {
  std::mt19937_64 random(4);
  const Meeting few = meeting(12, 300, &random), none = meeting(0, 300, &random);
  EXPECT_FALSE(align_features(few.a, few.b, few.truth));
  EXPECT_FALSE(align_features(none.a, none.b, none.truth));
  const Meeting far = meeting(60, 100, &random);
  EXPECT_FALSE(align_features(far.a, far.b, far.truth * SE3(Quaternion::Identity(), Vec3(3.0, 0.0, 0.0))))
      << "a start that is metres off";
  const Meeting some = meeting(25, 100, &random);
  EXPECT_TRUE(align_features(some.a, some.b, some.truth));
  EXPECT_FALSE(align_features(some.a, some.b, std::nullopt)) << "where nothing is known, more are asked for";
  const LocalMap empty = submap_of({}, SE3(), &random);
  EXPECT_FALSE(align_features(empty, far.b, far.truth));
  EXPECT_FALSE(align_features(far.a, empty, far.truth));
}

TEST(FeatureAlignment, ASmallThingMayBeOneOfTwo) {
  std::mt19937_64 random(7);
  Features thing = scene(60, &random);
  for (PointFeature& point : thing) point.position = 0.1F * point.position + Eigen::Vector3f(0.0F, 0.0F, 1.0F);
  const LocalMap a = submap_of(thing, SE3(), &random), b = submap_of(thing, SE3(), &random);
  EXPECT_FALSE(align_features(a, b, std::nullopt));
}

TEST(GraphDetector, FindsAnotherSessionsPlaceByPointsAloneWhereObjectsSayNothing) {
  std::mt19937_64 random(8);
  const Meeting both = meeting(80, 200, &random);
  LocalMap earlier = both.a, query = both.b;
  earlier.segment = LocalMap::kOtherSession;
  GraphDetector detector{LoopOptions()};
  for (int i = 0; i < 5; ++i) {
    LocalMap elsewhere = submap_of(scene(300, &random), SE3(), &random);
    elsewhere.segment = LocalMap::kOtherSession;
    detector.insert(elsewhere);
  }
  EXPECT_TRUE(detector.detect(query).empty());
  detector.insert(earlier);
  const std::vector<LoopClosure> loops = detector.detect(query);
  ASSERT_EQ(loops.size(), 1U);
  EXPECT_TRUE(loops[0].accepted);
  EXPECT_EQ(loops[0].reason, LoopReason::kFoundBySource);
  EXPECT_GE(loops[0].inliers, 50);
  EXPECT_TRUE(loops[0].matches.empty());
  const Vec6 error = se3_log(both.truth.inverse() * loops[0].T_match_query);
  EXPECT_LT(error.head<3>().norm(), 0.01);
  EXPECT_LT(error.tail<3>().norm(), radians(0.4));

  query.segment = LocalMap::kOtherSession;
  EXPECT_TRUE(detector.detect(query).empty()) << "of one part of the odometry, where the front end looks itself";
  query.segment = 0;
  // The match's, as the query sees it, and turned away from it.
  query.up = {both.truth.q.conjugate() * both.a.up.direction, true};
  LocalMap upright = earlier;
  upright.up.certain = true;
  GraphDetector with_up{LoopOptions()};
  with_up.insert(upright);
  EXPECT_EQ(with_up.detect(query).size(), 1U);
  query.up.direction = -query.up.direction;
  EXPECT_TRUE(with_up.detect(query).empty());
}

TEST(FeatureAlignment, PointsOnOneLineTellNoPose) {
  std::mt19937_64 random(5);
  Features line = scene(60, &random);
  for (std::size_t i = 0; i < line.size(); ++i) {
    line[i].position = Eigen::Vector3f(0.02F * static_cast<float>(i), 0.0F, 1.5F);
  }
  const LocalMap a = submap_of(line, SE3(), &random), b = submap_of(line, SE3(), &random);
  EXPECT_FALSE(align_features(a, b, SE3()));
}

TEST(FeatureAlignment, AWindowGivesEachPointOnceAndThoseSeenMostOften) {
  std::mt19937_64 random(6);
  const Features points = scene(800, &random);
  std::deque<ObservedFrame> window(4);
  for (std::size_t k = 0; k < window.size(); ++k) {
    window[k].stamp_ns = static_cast<std::int64_t>(k) * 500'000'000;
    window[k].T_odom_camera = SE3(Quaternion::Identity(), Vec3(0.1 * static_cast<double>(k), 0.0, 0.0));
    if (k == 3) continue;  // one without
    Features shown;
    for (const PointFeature& point : points) {
      if (k > 0 && point.id >= 300) continue;
      const Vec3 in_camera = window[k].T_odom_camera.inverse() * point.position.cast<double>();
      shown.push_back({point.id, in_camera.cast<float>(), point.descriptor});
    }
    window[k].features = std::make_shared<const Features>(shown);
  }
  const auto features = make_features(window, 1);
  ASSERT_NE(features, nullptr);
  ASSERT_EQ(features->size(), 500U);
  const SE3 T_anchor_world = window[1].T_odom_camera.inverse();
  for (std::size_t i = 0; i < features->size(); ++i) {
    const PointFeature& feature = (*features)[i];
    EXPECT_EQ(feature.id, static_cast<std::int64_t>(i)) << "seen three times, or first";
    const Vec3 expected = T_anchor_world * points[i].position.cast<double>();
    EXPECT_LT((feature.position.cast<double>() - expected).norm(), 1e-5);
    EXPECT_EQ(feature.descriptor, points[i].descriptor);
  }
  for (ObservedFrame& frame : window) frame.features.reset();
  EXPECT_EQ(make_features(window, 1), nullptr);
}

}  // namespace
}  // namespace semantic_topo_loop::core
