#include "loop/graph/relocalisation.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "loop/graph/graph_detector.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "support/synthetic_desk.h"

namespace semantic_topo_loop::core {
namespace {

using testing::random_desk;
using testing::run;
using testing::RunOutcome;
using testing::RunSetup;

double error_m(const SE3& a, const SE3& b) { return (a.t - b.t).norm(); }
double error_deg(const SE3& a, const SE3& b) { return degrees(rotation_angle(a.q, b.q)); }

/// The submaps of a run past a desk, in its world.
std::vector<LocalMap> map_of(std::uint64_t seed) {
  RunSetup setup;
  setup.desk = random_desk(seed, 12);
  setup.visits = {{0.0, 14.0, 0.0, 90.0}};
  setup.end_s = 14.0;
  std::vector<LocalMap> submaps;
  run(LoopOptions(), setup, [&submaps](const LoopDetector& detector) { submaps = detector.submaps(); });
  return submaps;
}

/// A run past a desk with an odometry in a world of its own.
RunSetup later_run(std::uint64_t seed) {
  RunSetup setup;
  setup.desk = random_desk(seed, 12);
  setup.visits = {{0.0, 14.0, 70.0, -10.0}};
  setup.end_s = 14.0;
  setup.T_odom_world = SE3(so3_exp(Vec3(0.7, -1.1, 2.0)), Vec3(3.0, -8.0, 1.0));
  return setup;
}

TEST(Relocalisation, FindsARunInTheMapOfAnEarlierOne) {
  for (std::uint64_t seed = 1; seed <= 2; ++seed) {
    RunSetup setup = later_run(seed);
    setup.earlier_map = map_of(seed);
    ASSERT_FALSE(setup.earlier_map.empty());
    std::optional<Relocalisation> found;
    const RunOutcome outcome =
        run(LoopOptions(), setup, [&found](const LoopDetector& detector) { found = detector.relocalisation(); });
    ASSERT_TRUE(found.has_value()) << "seed " << seed;
    EXPECT_LT(error_m(found->T_earlier_odom * setup.T_odom_world, SE3()), 0.1);
    EXPECT_LT(error_deg(found->T_earlier_odom * setup.T_odom_world, SE3()), 3.0);
    EXPECT_EQ(found->total, outcome.accepted());
    for (const LoopClosure& loop : outcome.loops) EXPECT_TRUE(loop.T_earlier_match.has_value());
  }
}

TEST(Relocalisation, IsThatOfTheOdometrySinceItsLastBreak) {
  RunSetup setup = later_run(1);
  setup.visits.push_back({14.0, 26.0, -10.0, 70.0});
  setup.end_s = 26.0;
  setup.earlier_map = map_of(1);
  setup.drift = SE3(so3_exp(Vec3(0.0, 0.0, 1.0)), Vec3(5.0, 3.0, 0.0));
  setup.drift_from_s = 16.0;
  setup.drift_is_break = true;
  std::optional<Relocalisation> found;
  run(LoopOptions(), setup, [&found](const LoopDetector& detector) { found = detector.relocalisation(); });
  ASSERT_TRUE(found.has_value());
  EXPECT_LT(error_m(found->T_earlier_odom * setup.T_odom_world * setup.drift, SE3()), 0.1);
  EXPECT_EQ(found->agreeing, found->total) << "those before the break do not count against it";
}

TEST(Relocalisation, IsThatOfTheOdometrySinceAJumpThatTheBoxesShow) {
  RunSetup setup = later_run(1);
  setup.visits.push_back({14.0, 26.0, -10.0, 70.0});
  setup.end_s = 26.0;
  setup.earlier_map = map_of(1);
  setup.drift = SE3(so3_exp(Vec3(0.0, 0.0, radians(18.0))), Vec3(0.1, 0.0, 0.0));
  setup.drift_from_s = 16.0;
  std::optional<Relocalisation> before, found;
  int frames = 0;
  setup.at_every_frame = [&](const LoopDetector& detector) {
    if (++frames == 159) before = detector.relocalisation();
  };
  run(LoopOptions(), setup, [&found](const LoopDetector& detector) { found = detector.relocalisation(); });
  ASSERT_TRUE(before.has_value());
  ASSERT_TRUE(found.has_value());
  EXPECT_LT(error_m(found->T_earlier_odom * setup.T_odom_world * setup.drift, SE3()), 0.1);
  EXPECT_EQ(found->agreeing, found->total) << "those before the jump do not count against it";
}

TEST(Relocalisation, IsNotFoundInTheMapOfAnotherPlace) {
  for (std::uint64_t seed = 1; seed <= 2; ++seed) {
    RunSetup setup = later_run(seed);
    setup.earlier_map = map_of(seed + 50);
    ASSERT_FALSE(setup.earlier_map.empty());
    run(LoopOptions(), setup,
        [](const LoopDetector& detector) { EXPECT_FALSE(detector.relocalisation().has_value()); });
  }
}

TEST(Relocalisation, AMapDoesNotChangeTheRunsOwnLoops) {
  RunSetup setup = later_run(2);
  setup.visits.push_back({32.0, 44.0, 0.0, 70.0});
  setup.end_s = 44.0;
  const std::vector<LoopClosure> alone = run(LoopOptions(), setup).loops;
  setup.earlier_map = map_of(2);
  std::vector<LoopClosure> own;
  for (const LoopClosure& loop : run(LoopOptions(), setup).loops) {
    if (!loop.T_earlier_match) own.push_back(loop);
  }
  EXPECT_FALSE(alone.empty());
  ASSERT_EQ(own.size(), alone.size());
  for (std::size_t i = 0; i < own.size(); ++i) {
    EXPECT_EQ(own[i].match_frame, alone[i].match_frame);
    EXPECT_EQ(own[i].T_match_query.t, alone[i].T_match_query.t);
  }
}

TEST(Relocalisation, AbstainsBetweenPlacesOfTwoSessionsThatLookAlike) {
  RunSetup setup = later_run(1);
  setup.earlier_map = map_of(1);
  std::vector<LocalMap> others = setup.earlier_map;
  for (LocalMap& other : others) {
    other.T_odom_anchor.t += Vec3(6.0, 0.0, 0.0);
    other.stamp_ns += 30 * 86'400 * 1'000'000'000LL;
    other.drift_rad_s = 0.002;
    for (std::int64_t* id : {&other.keyframe_id, &other.frame_id, &other.begin_frame, &other.end_frame}) *id += 10'000;
  }
  setup.earlier_map.insert(setup.earlier_map.end(), others.begin(), others.end());
  const RunOutcome outcome = run(LoopOptions(), setup);
  EXPECT_EQ(outcome.accepted(), 0);
  const auto is_ambiguous = [](const LoopClosure& loop) { return loop.reason == LoopReason::kAmbiguous; };
  EXPECT_TRUE(std::any_of(outcome.loops.begin(), outcome.loops.end(), is_ambiguous));
  // How parts of a map that nothing joins stand to each other means nothing.
  for (LocalMap& map : setup.earlier_map) map.segment = map.keyframe_id < 10'000 ? -1 : -2;
  EXPECT_GT(run(LoopOptions(), setup).accepted(), 0);
}

TEST(GraphDetector, TakesAPlaceForAnotherWhereTheOdometryHasItUnlessThatStoodOnTheWay) {
  const std::vector<LocalMap> map = map_of(1);
  ASSERT_FALSE(map.empty());
  GraphDetector detector{LoopOptions()};
  detector.insert(map.front());
  LocalMap again = map.front();
  const std::int64_t later_ns = 60'000'000'000;
  for (std::int64_t* stamp_ns : {&again.stamp_ns, &again.end_ns}) *stamp_ns += later_ns;
  for (std::int64_t* id : {&again.keyframe_id, &again.frame_id, &again.begin_frame, &again.end_frame}) *id += 10'000;
  again.T_odom_anchor.t += Vec3(4.0, 0.0, 0.0);
  const auto reasons = [&] {
    std::set<LoopReason> reasons;
    for (const LoopClosure& loop : detector.detect(again)) reasons.insert(loop.reason);
    return reasons;
  };
  EXPECT_EQ(reasons(), std::set<LoopReason>{LoopReason::kAmbiguous});
  again.missed.translation_m = 3.0;
  EXPECT_EQ(reasons(), std::set<LoopReason>{LoopReason::kAccepted});
}

LoopClosure vote(const SE3& T_earlier_query, double sigma) {
  LoopClosure loop;
  loop.accepted = true;
  loop.T_earlier_match = SE3(so3_exp(Vec3(0.1, 0.2, 0.3)), Vec3(1.0, 2.0, 3.0));
  loop.T_match_query = loop.T_earlier_match->inverse() * T_earlier_query;
  loop.covariance = sigma * sigma * Mat6::Identity();
  return loop;
}

TEST(Relocaliser, TakesTheConsensusAndNotTheMean) {
  std::mt19937_64 random(3);
  const auto vector = [&random](double half) {
    return Vec3(testing::uniform(random, -half, half), testing::uniform(random, -half, half),
                testing::uniform(random, -half, half));
  };
  const SE3 truth(so3_exp(Vec3(1.0, -0.4, 0.8)), Vec3(5.0, -2.0, 1.0));
  Relocaliser relocaliser;
  for (int i = 0; i < 30; ++i) {
    const SE3 T_odom_query(so3_exp(vector(2.0)), vector(4.0));
    const bool wrong = i % 3 == 0;
    const SE3 error(so3_exp(vector(wrong ? 1.5 : 0.02)), vector(wrong ? 3.0 : 0.03));
    relocaliser.add(vote(truth * T_odom_query * error, 0.03), T_odom_query);
  }
  const std::optional<Relocalisation> found = relocaliser.estimate();
  ASSERT_TRUE(found.has_value());
  EXPECT_EQ(found->agreeing, 20);
  EXPECT_EQ(found->total, 30);
  EXPECT_LT(error_m(found->T_earlier_odom, truth), 0.03);
  EXPECT_LT(error_deg(found->T_earlier_odom, truth), 0.5);
}

TEST(Relocaliser, NeedsThreeThatAgreeAndAMajority) {
  const SE3 truth(so3_exp(Vec3(0.3, 0.0, 0.0)), Vec3(1.0, 0.0, 0.0)), other(Mat3::Identity(), Vec3(-9.0, 0.0, 0.0));
  Relocaliser relocaliser;
  EXPECT_FALSE(relocaliser.estimate().has_value());
  for (int i = 0; i < 3; ++i) {
    EXPECT_FALSE(relocaliser.estimate().has_value());
    relocaliser.add(vote(truth, 0.03), SE3());
  }
  EXPECT_TRUE(relocaliser.estimate().has_value());
  for (int i = 0; i < 3; ++i) relocaliser.add(vote(other, 0.03), SE3());
  EXPECT_FALSE(relocaliser.estimate().has_value()) << "two places, three loops each";
}

TEST(Relocaliser, TheLastThousandLoopsCountAndNoneAfterARestart) {
  const SE3 truth(so3_exp(Vec3(0.3, 0.0, 0.0)), Vec3(1.0, 0.0, 0.0)), other(Mat3::Identity(), Vec3(-9.0, 0.0, 0.0));
  Relocaliser relocaliser;
  for (int i = 0; i < 1600; ++i) relocaliser.add(vote(i < 600 ? other : truth, 0.03), SE3());
  for (int times = 0; times < 2; ++times) {
    const std::optional<Relocalisation> found = relocaliser.estimate();
    ASSERT_TRUE(found.has_value());
    EXPECT_EQ(found->agreeing, 1000);
    EXPECT_EQ(found->total, 1000);
    EXPECT_LT(error_m(found->T_earlier_odom, truth), 1e-9);
  }
  relocaliser.restart();
  EXPECT_FALSE(relocaliser.estimate().has_value());
}

TEST(Relocaliser, IgnoresWhatIsNoLoopIntoTheMap) {
  Relocaliser relocaliser;
  for (int i = 0; i < 5; ++i) {
    LoopClosure rejected = vote(SE3(), 0.03), own = rejected, broken = rejected;
    rejected.accepted = false;
    own.T_earlier_match.reset();
    broken.covariance(0, 0) = std::nan("");
    for (const LoopClosure& loop : {rejected, own, broken}) relocaliser.add(loop, SE3());
  }
  EXPECT_FALSE(relocaliser.estimate().has_value());
}

}  // namespace
}  // namespace semantic_topo_loop::core
