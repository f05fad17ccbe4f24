#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "pose_graph/rejection/loop_rejection.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "support/synthetic_run.h"
#include "tools/perturbation/perturbation.h"

namespace semantic_topo_loop::core {
namespace {

std::vector<KeyframePose> odometry_of(const SyntheticRun& run) {
  std::vector<KeyframePose> keyframes;
  for (int k = 0; k < run.size(); ++k) keyframes.push_back({k, k, 0, run.odometry(k)});
  return keyframes;
}

/// The same map to a millimetre.
void expect_alike(const FinishedRun& a, const FinishedRun& b) {
  const auto p = a.graph.keyframes(), q = b.graph.keyframes();
  ASSERT_EQ(p.size(), q.size());
  for (std::size_t i = 0; i < p.size(); ++i) {
    EXPECT_LT((p[i].T_map_camera.t - q[i].T_map_camera.t).norm(), 1e-3) << i;
  }
}

/// With as many false loops as `options` say: none is kept, and none leaves a trace.
void expect_robust(const FalseLoopOptions& options, double drift_m, double drift_rad, std::uint64_t seed) {
  SyntheticRun run;
  run.drift(drift_m, drift_rad, seed);
  const std::vector<LoopClosure> right = noisy_loops(run, seed, 2);
  std::set<std::pair<std::int64_t, std::int64_t>> is_right;
  for (const LoopClosure& loop : right) is_right.insert({loop.query_keyframe_id, loop.match_keyframe_id});
  std::vector<LoopClosure> loops = right;
  int added = 0;
  for (const LoopClosure& loop : make_false_loops(odometry_of(run), options, seed)) {
    if (is_right.count({loop.query_keyframe_id, loop.match_keyframe_id}) != 0) continue;
    loops.push_back(loop);
    ++added;
  }
  ASSERT_GT(added, options.count / 2);
  const FinishedRun with = finish(run, loops), without = finish(run, right);
  int right_kept = 0;
  for (const LoopVerdict& verdict : with.end.loops) {
    const bool right_one = is_right.count({verdict.query_keyframe_id, verdict.match_keyframe_id}) != 0;
    EXPECT_TRUE(right_one || !verdict.kept) << verdict.query_keyframe_id << " " << verdict.match_keyframe_id;
    EXPECT_TRUE(verdict.kept || !verdict.reason.empty());
    right_kept += right_one && verdict.kept ? 1 : 0;
  }
  EXPECT_GT(right_kept, static_cast<int>(0.9 * static_cast<double>(right.size())));
  expect_alike(with, without);
}

TEST(FalseLoops, AsManyRandomOnesAsRightOnesAreAllRejected) {
  FalseLoopOptions options;
  options.count = 45;
  for (std::uint64_t seed = 1; seed <= 3; ++seed) expect_robust(options, 0.003, 0.001, seed);
}

TEST(FalseLoops, CoherentClustersAreRejected) {
  FalseLoopOptions options;
  options.count = 15;
  options.cluster_size = 5;
  for (std::uint64_t seed = 1; seed <= 3; ++seed) expect_robust(options, 0.003, 0.001, seed);
}

/// Few right loops, all on the evidence of one another, and a place taken for another before any of them.
TEST(FalseLoops, ACoherentClusterThatComesFirstLeavesNoTrace) {
  SyntheticRun run;
  run.drift(0.003, 0.001, 4);
  Random random(4);
  std::vector<LoopClosure> right, all;
  for (int k = 170; k < 190; k += 2) {
    right.push_back(run.loop(k, k - 100, random_tangent(&random, kSigma_m, kSigma_rad), kSigma_m, kSigma_rad, 100));
  }
  const SE3 error(so3_exp(Vec3(0.7, 0.45, -0.55)), Vec3(1.4, -1.5, 0.7));
  for (int k = 60; k < 78; k += 2) {
    LoopClosure wrong = run.exact_loop(k, k - 50);
    wrong.T_match_query = run.truth(k - 50).inverse() * run.truth(10) * error * run.truth(60).inverse() * run.truth(k);
    all.push_back(wrong);
  }
  all.insert(all.end(), right.begin(), right.end());
  const FinishedRun with = finish(run, all), without = finish(run, right);
  int right_kept = 0;
  for (const LoopVerdict& verdict : with.end.loops) {
    EXPECT_TRUE(verdict.query_keyframe_id >= 170 || !verdict.kept) << verdict.query_keyframe_id;
    right_kept += verdict.query_keyframe_id >= 170 && verdict.kept ? 1 : 0;
  }
  EXPECT_GE(right_kept, 7);
  expect_alike(with, without);
}

TEST(FalseLoops, TheSameSeedGivesTheSameLoops) {
  const auto keyframes = odometry_of(SyntheticRun());
  const auto a = make_false_loops(keyframes, {}, 5), b = make_false_loops(keyframes, {}, 5);
  const auto c = make_false_loops(keyframes, {}, 6);
  ASSERT_EQ(a.size(), 10U);
  ASSERT_EQ(b.size(), 10U);
  for (std::size_t i = 0; i < a.size(); ++i) EXPECT_EQ(a[i].T_match_query.t, b[i].T_match_query.t);
  EXPECT_NE(a.front().T_match_query.t, c.front().T_match_query.t);
  EXPECT_TRUE(make_false_loops({}, {}, 1).empty());
}

TEST(LoopVerdict, SaysWhyALoopIsRefused) {
  SyntheticRun run;
  run.drift(0.003, 0.001, 1);
  std::vector<LoopClosure> loops = noisy_loops(run, 1, 2);
  LoopClosure bad = loops[5];
  bad.covariance.setZero();
  loops.push_back(bad);
  LoopClosure wrong = run.exact_loop(175, 20);
  wrong.T_match_query.t += Vec3(2.0, 0.0, 0.0);
  loops.push_back(wrong);
  bool found_bad = false, found_wrong = false;
  for (const LoopVerdict& verdict : finish(run, loops).end.loops) {
    found_bad = found_bad || verdict.reason.find("covariance is not positive definite") != std::string::npos;
    if (verdict.query_keyframe_id != 175 || verdict.match_keyframe_id != 20) continue;
    found_wrong = true;
    EXPECT_FALSE(verdict.kept);
    EXPECT_EQ(verdict.reason, "no other loop agrees with it or more disagree");
  }
  EXPECT_TRUE(found_bad);
  EXPECT_TRUE(found_wrong);
}

TEST(Withdraw, TheMapIsAsIfTheLoopHadNeverBeen) {
  SyntheticRun run(40);
  run.drift(0.003, 0.001, 1);
  const LoopClosure first = run.exact_loop(60, 20);
  LoopClosure second = run.exact_loop(79, 39);
  second.T_match_query.t += Vec3(0.05, 0.0, 0.0);
  FinishedRun both = finish(run, {first, second}), one = finish(run, {first});
  EXPECT_FALSE(both.graph.withdraw(79, 38));
  EXPECT_TRUE(both.graph.withdraw(79, 39));
  EXPECT_FALSE(both.graph.withdraw(79, 39));
  const MapCorrection correction = both.graph.process(run.end_frame(), {});
  EXPECT_TRUE(correction.changed);
  EXPECT_EQ(correction.loops.size(), 1U);
  const auto a = both.graph.keyframes(), b = one.graph.keyframes();
  for (std::size_t i = 0; i < a.size(); ++i) EXPECT_LT((a[i].T_map_camera.t - b[i].T_map_camera.t).norm(), 2e-3) << i;
}

TEST(PoseGraph, AJumpThatTheMotionDoesNotShowIsFound) {
  // A turn of 6 deg in one of many motions: spread over the whole way it would leave the keyframes far off.
  SyntheticRun run;
  Vec6 slip = Vec6::Zero();
  slip(5) = 0.1;
  run.drift(0.0003, 0.0001, 3, slip, 60, 61);
  const double before = run.worst_odometry_error_m();
  ASSERT_GT(before, 0.2);
  EXPECT_LT(run.worst_error_m(finish(run, noisy_loops(run, 3, 2)).graph.keyframes()), 0.35 * before);
}

TEST(PoseGraph, JumpsThatTheMotionShowsAreTakenOut) {
  // Two in one frame each, between which no loop tells where they were.
  SyntheticRun run;
  run.drift(0.0005, 0.0002, 3);
  run.restart(80, SE3(so3_exp(Vec3(0.02, 0.05, -0.04)), Vec3(0.3, -0.1, 0.1)));
  run.restart(130, SE3(so3_exp(Vec3(-0.05, 0.02, 0.03)), Vec3(-0.2, -0.25, 0.1)));
  std::vector<LoopClosure> loops;
  Random random(3);
  for (int k = 165; k < 200; k += 3) {
    loops.push_back(run.loop(k, k - 100, random_tangent(&random, kSigma_m, kSigma_rad), kSigma_m, kSigma_rad));
  }
  const double before = run.worst_odometry_error_m();
  ASSERT_GT(before, 0.4);
  EXPECT_LT(run.worst_error_m(finish(run, loops).graph.keyframes()), 0.15 * before);
}

/// A run that drifts steadily, with loops of one revisit, and a cluster at a place that looks like another.
struct ClusterCase {
  Trajectory trajectory;
  GraphKnowledge knowledge;
  std::size_t right = 0;  ///< loops; the false ones follow
};

ClusterCase make_cluster_case(const SE3& error) {
  SyntheticRun run;
  Vec6 bias;
  bias << 0.004, 0.002, -0.003, 0.0005, -0.001, 0.001;
  run.drift(0.0005, 0.0002, 7, bias);
  ClusterCase result;
  result.trajectory.T_map_vertex = run.odometry();
  result.trajectory.edges = run.edges();
  Random random(7);
  const auto add = [&](int query, int match, const SE3& T_off) {
    LoopClosure loop = run.loop(query, match, random_tangent(&random, kSigma_m, kSigma_rad), kSigma_m, kSigma_rad, 20);
    loop.T_match_query = run.truth(match).inverse() * run.truth(25) * T_off * run.truth(25).inverse() *
                         run.truth(match) * loop.T_match_query;
    result.trajectory.loops.push_back(graph_loop(loop));
  };
  for (int k = 150; k < 200; k += 5) add(k, k - 100, SE3());
  result.right = result.trajectory.loops.size();
  for (int k = 100; k < 120; k += 4) add(k, k - 80, error);
  result.knowledge.kept.assign(result.trajectory.loops.size(), true);
  PoseGraphOptions options;
  options.robust = "none";
  const OptimizedTrajectory all = optimize_trajectory(result.trajectory, options, result.knowledge, Effort::kFull);
  result.trajectory.T_map_vertex = all.T_map_vertex;
  result.knowledge = all.knowledge;
  return result;
}

TEST(LoopClusters, AreLoopsThatShareEvidence) {
  const ClusterCase data = make_cluster_case(SE3());
  const auto clusters = loop_clusters(data.trajectory.loops, data.knowledge.kept);
  ASSERT_EQ(clusters.size(), 2U);
  EXPECT_EQ(clusters[0].size(), data.right);
  EXPECT_EQ(clusters[1].front(), data.right);
  std::vector<bool> some(data.trajectory.loops.size(), false);
  some[1] = some[data.right] = true;
  EXPECT_EQ(loop_clusters(data.trajectory.loops, some), (std::vector<std::vector<std::size_t>>{{1}, {data.right}}));
}

TEST(LoopClusters, OneThatTheOdometryDoesNotLetExpectGoes) {
  const ClusterCase data = make_cluster_case(SE3(so3_exp(Vec3(0.3, -0.4, 0.2)), Vec3(0.8, -0.6, 0.4)));
  std::vector<bool> right(data.trajectory.loops.size(), false);
  std::fill_n(right.begin(), data.right, true);
  EXPECT_EQ(audit_clusters(data.trajectory, {}, data.knowledge), right);
}

TEST(LoopClusters, OnesThatDriftExplainsStay) {
  const ClusterCase data = make_cluster_case(SE3());
  EXPECT_EQ(audit_clusters(data.trajectory, {}, data.knowledge), data.knowledge.kept);
}

TEST(LoopConsistency, ALoneWrongLoopHasNoVoteAndUnbrokenOnesDo) {
  SyntheticRun run;
  const std::vector<OdometryEdge> edges = run.edges();
  std::vector<GraphLoop> loops;
  for (int k = 150; k < 160; k += 2) loops.push_back(graph_loop(run.exact_loop(k, k - 100)));
  loops.push_back(loops[2]);
  loops.back().T_from_to.t.x() += 1.0;
  LoopConsistency consistency;
  EXPECT_EQ(consistency.vote(edges, loops), (std::vector<bool>{true, true, true, true, true, false}));
  EXPECT_EQ(LoopConsistency().vote(edges, {loops[0]}), std::vector<bool>{true});
  // Among some of them, and against what a trusted one says.
  const std::vector<bool> all(6, true), none(6, false), wrong{false, false, false, false, false, true};
  EXPECT_EQ(consistency.vote(edges, loops, {true, true, false, true, true, false}, none),
            (std::vector<bool>{true, true, false, true, true, false}));
  const std::vector<bool> votes = consistency.vote(edges, loops, all, wrong);
  EXPECT_FALSE(votes[2]);
  EXPECT_TRUE(votes[5]);
}

}  // namespace
}  // namespace semantic_topo_loop::core
