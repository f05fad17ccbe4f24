// What a pose graph holds and says does not grow with the length of the run.

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <numeric>
#include <utility>
#include <vector>

#include "geometry/relative_pose.h"
#include "pose_graph/graph_state.h"
#include "pose_graph/solver/trajectory_optimizer.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/pose_graph/pose_graph.h"
#include "support/synthetic_run.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kPerRound = 100;

/// Loops from every keyframe to the same place of up to four earlier rounds.
std::vector<LoopClosure> loops_of(const SyntheticRun& run, int k, Random* random) {
  std::vector<LoopClosure> loops;
  for (int rounds = 1; rounds <= 4 && k - rounds * kPerRound >= 0; ++rounds) {
    const Vec6 noise = random_tangent(random, kSigma_m, kSigma_rad);
    loops.push_back(run.loop(k, k - rounds * kPerRound, noise, kSigma_m, kSigma_rad));
  }
  return loops;
}

/// Who writes a graph's deltas down, one after the other, as a map's file.
struct Written {
  void take(const GraphDelta& delta) {
    if (delta.is_whole) keyframes.clear();
    for (const GraphKeyframe& keyframe : delta.state.keyframes) keyframes[keyframe.pose.keyframe_id] = keyframe;
    told += delta.state.keyframes.size();
    edges = delta.state.edges.size();
  }
  std::map<std::int64_t, GraphKeyframe> keyframes;
  std::size_t told = 0, edges = 0;
};

struct LongRun {
  explicit LongRun(int rounds) : run(kPerRound, rounds), graph(PoseGraphOptions()) {
    run.drift(0.004, 0.002, 5);
    Random random(6);
    for (int k = 0; k < run.size(); ++k) {
      const std::vector<LoopClosure> loops = loops_of(run, k, &random);
      accepted += static_cast<int>(loops.size());
      follow(graph.process(run.frame(k), loops));
      if (k % 3 == 0) take_delta(k < run.size() / 3 || k > run.size() / 2);
    }
    follow(graph.process(run.end_frame(), {}));
    take_delta(true);
  }

  void take_delta(bool comes) {
    const GraphDelta delta = graph.take_delta(false);
    written.take(delta);
    if (comes) with_losses.take(delta);
  }
  void follow(const MapCorrection& correction) {
    vertices = std::max(vertices, graph.size().vertices);
    if (!correction.changed) return;
    loops = std::max(loops, graph.size().loops);
    for (const KeyframePose& keyframe : correction.keyframes) keyframes[keyframe.keyframe_id] = keyframe;
    for (const LoopVerdict& verdict : correction.loops) verdicts[verdict.number] = verdict;
    largest = std::max(largest, correction.loops.size());
  }

  SyntheticRun run;
  PoseGraph graph;
  Written written, with_losses;  ///< with_losses: a sixth of them did not come
  int accepted = 0;
  std::size_t vertices = 0, loops = 0;  ///< at most
  std::size_t largest = 0;              ///< verdicts of one correction
  std::map<std::int64_t, KeyframePose> keyframes;
  std::map<std::int64_t, LoopVerdict> verdicts;
};

const LongRun& ten_rounds() {
  static const LongRun run(10);
  return run;
}

TEST(Growth, RoundsOfOneRoomFitIntoOneGraph) {
  const LongRun& many = ten_rounds();
  EXPECT_GE(many.accepted, 3000);
  EXPECT_LE(many.vertices, 400U);
  EXPECT_LE(many.loops, 900U) << "what comes between two solutions, too";
  EXPECT_EQ(many.graph.keyframes().size(), static_cast<std::size_t>(many.run.size())) << "none is lost";
  EXPECT_LT(many.run.worst_error_m(many.graph.keyframes()), 0.2);
  EXPECT_GT(many.run.worst_odometry_error_m(), 0.4) << "what the loops correct";
}

TEST(Growth, CorrectionsSayWhatIsNew) {
  const LongRun& run = ten_rounds();
  EXPECT_EQ(run.verdicts.size(), static_cast<std::size_t>(run.accepted)) << "one at least on every loop";
  EXPECT_LT(run.largest, run.verdicts.size() / 3);
  int kept = 0;
  for (const auto& [number, verdict] : run.verdicts) kept += verdict.kept ? 1 : 0;
  EXPECT_GT(kept, 0.98 * run.accepted) << "all are right";
  // Who follows the corrections has every keyframe where the graph has it.
  for (const KeyframePose& keyframe : run.graph.keyframes()) {
    const auto followed = run.keyframes.find(keyframe.keyframe_id);
    ASSERT_NE(followed, run.keyframes.end()) << keyframe.keyframe_id;
    EXPECT_EQ(followed->second.T_map_camera.t, keyframe.T_map_camera.t) << keyframe.keyframe_id;
  }
}

/// Poses to the last bit, of keyframes that move with others by these.
void expect_written(const GraphState& state, const Written& all) {
  ASSERT_EQ(all.keyframes.size(), state.keyframes.size());
  SE3 T_map_vertex;
  for (const GraphKeyframe& keyframe : state.keyframes) {
    const GraphKeyframe& written = all.keyframes.at(keyframe.pose.keyframe_id);
    ASSERT_EQ(written.T_vertex_keyframe.has_value(), keyframe.T_vertex_keyframe.has_value());
    if (!written.T_vertex_keyframe) T_map_vertex = written.pose.T_map_camera;
    const SE3 T_map_camera =
        written.T_vertex_keyframe ? T_map_vertex * *written.T_vertex_keyframe : written.pose.T_map_camera;
    EXPECT_EQ(T_map_camera.t, keyframe.pose.T_map_camera.t) << keyframe.pose.keyframe_id;
    EXPECT_EQ(T_map_camera.q.coeffs(), keyframe.pose.T_map_camera.q.coeffs());
  }
}

TEST(Growth, DeltasAddUpToTheGraph) {
  const LongRun& run = ten_rounds();
  const GraphState state = run.graph.state();
  EXPECT_LT(run.written.told, 35 * state.keyframes.size()) << "of corrections that move all of them";
  EXPECT_LT(state.edges.size(), state.keyframes.size() / 2) << "keyframes that move with others";
  EXPECT_EQ(run.written.edges, state.edges.size());
  expect_written(state, run.written);
}

TEST(Growth, WhatOfThemIsLostComesWithTheNextCoarserGraph) {
  const LongRun& run = ten_rounds();
  EXPECT_LT(run.with_losses.told, run.written.told);
  expect_written(run.graph.state(), run.with_losses);
}

TEST(Growth, OnlyNewKeyframesAreWrittenWhileNothingMoves) {
  SyntheticRun run;
  PoseGraph graph{PoseGraphOptions()};
  Written written;
  for (int k = 0; k < run.size(); ++k) {
    graph.process(run.frame(k), {});
    written.take(graph.take_delta(false));
  }
  EXPECT_EQ(written.told, static_cast<std::size_t>(run.size()));
  EXPECT_EQ(graph.take_delta(true).state.keyframes.size(), written.told) << "all of them, if that is asked for";
}

TEST(Growth, OdometryThatBreaksAgainAndAgainFitsIntoOneGraph) {
  const SyntheticRun run(kPerRound, 20);
  PoseGraph graph{PoseGraphOptions()};
  std::size_t vertices = 0;
  std::map<std::int64_t, LoopVerdict> verdicts;
  const auto follow = [&](const MapCorrection& correction) {
    vertices = std::max(vertices, graph.size().vertices);
    for (const LoopVerdict& verdict : correction.loops) verdicts[verdict.match_keyframe_id] = verdict;
  };
  for (int k = 0; k < run.size(); ++k) {
    Frame frame = run.frame(k);
    frame.is_break = k % 4 == 0;
    std::vector<LoopClosure> loops;
    if (k == 202) loops.push_back(run.exact_loop(k, 102));
    if (k == 1902) loops = {run.exact_loop(k, 102), run.exact_loop(k, 2), run.exact_loop(k, 302)};
    follow(graph.process(frame, loops));
  }
  follow(graph.process(run.end_frame(), {}));
  EXPECT_LE(vertices, 401U);
  EXPECT_EQ(graph.keyframes().size(), static_cast<std::size_t>(run.size()));
  EXPECT_TRUE(verdicts[102].kept) << "a loop has held it: " << verdicts[102].reason;
  EXPECT_TRUE(verdicts[2].kept) << "before the first break: " << verdicts[2].reason;
  EXPECT_FALSE(verdicts[302].kept) << "it is not known any more where it was";
}

TEST(Growth, KeyframesThatStayAreNotToldAgain) {
  SyntheticRun run;
  run.drift(0.004, 0.002, 5);
  PoseGraph graph{PoseGraphOptions()};
  std::map<std::int64_t, SE3> told;
  std::size_t again = 0;
  for (int k = 0; k < run.size(); ++k) {
    std::vector<LoopClosure> loops;
    if (k == 150 || k == 199) loops.push_back(run.exact_loop(k, k - kPerRound));
    for (const KeyframePose& keyframe : graph.process(run.frame(k), loops).keyframes) {
      const auto before = told.find(keyframe.keyframe_id);
      if (before != told.end()) {
        ++again;
        const double moved = (before->second.t - keyframe.T_map_camera.t).norm();
        EXPECT_TRUE(moved > 2e-4 || rotation_angle(before->second.q, keyframe.T_map_camera.q) > 1e-4);
      }
      told[keyframe.keyframe_id] = keyframe.T_map_camera;
    }
  }
  EXPECT_GT(told.size(), 150U);
  EXPECT_LT(again, told.size());
}

/// A run with a vertex for every keyframe, and the numbers of these.
std::pair<Trajectory, std::vector<std::size_t>> graph_of(const SyntheticRun& run) {
  Trajectory trajectory;
  trajectory.T_map_vertex = run.odometry();
  trajectory.edges = run.edges();
  std::vector<std::size_t> keyframes(trajectory.T_map_vertex.size());
  std::iota(keyframes.begin(), keyframes.end(), 0U);
  return {std::move(trajectory), std::move(keyframes)};
}

TEST(Coarsening, LeavesOutWhatIsLongAgo) {
  SyntheticRun run;
  run.drift(0.004, 0.002, 7);
  auto [trajectory, keyframes] = graph_of(run);
  const std::vector<Carrier> carriers = coarsen(60, std::vector<bool>(keyframes.size(), true), &keyframes, &trajectory);
  ASSERT_EQ(keyframes.size(), 60U);
  ASSERT_EQ(trajectory.T_map_vertex.size(), 60U);
  ASSERT_EQ(trajectory.edges.size(), 59U);
  ASSERT_EQ(carriers.size(), static_cast<std::size_t>(run.size()));
  EXPECT_EQ(keyframes.front(), 0U);
  EXPECT_EQ(keyframes.back(), carriers.size() - 1);
  std::size_t widest = 0;
  for (std::size_t v = 0; v + 1 < keyframes.size(); ++v) {
    const std::size_t step = keyframes[v + 1] - keyframes[v], age = carriers.size() - keyframes[v];
    widest = std::max(widest, step);
    EXPECT_LE(step, 1 + age / 10) << "of a correction no more than that share falls into one step";
    const SE3 expected =
        run.odometry(static_cast<int>(keyframes[v])).inverse() * run.odometry(static_cast<int>(keyframes[v + 1]));
    EXPECT_LT((expected.inverse() * trajectory.edges[v].T_from_to).t.norm(), 1e-9);
  }
  EXPECT_GT(widest, 3U);
  for (std::size_t k = 0; k < carriers.size(); ++k) {
    const SE3& T_map_vertex = trajectory.T_map_vertex[static_cast<std::size_t>(carriers[k].vertex)];
    const SE3 T_map_keyframe = T_map_vertex * carriers[k].T_vertex_keyframe.value_or(SE3());
    EXPECT_LT((T_map_keyframe.t - run.odometry(static_cast<int>(k)).t).norm(), 1e-9) << k;
  }
}

TEST(Coarsening, NothingMovesWithWhatWasBeforeABreak) {
  SyntheticRun run;
  auto [trajectory, keyframes] = graph_of(run);
  constexpr std::size_t kBreak = 20;
  trajectory.edges[kBreak].is_break = true;
  coarsen(30, std::vector<bool>(keyframes.size(), false), &keyframes, &trajectory);
  ASSERT_EQ(keyframes.size(), 30U);
  const auto after = std::find(keyframes.begin(), keyframes.end(), kBreak + 1);
  ASSERT_NE(after, keyframes.end());
  for (std::size_t v = 0; v < trajectory.edges.size(); ++v) {
    EXPECT_EQ(trajectory.edges[v].is_break, keyframes[v + 1] == *after);
  }
}

TEST(Coarsening, WhatNoLoopHoldsBehindABreakGoesWhereBreaksAreTooMany) {
  SyntheticRun run;
  auto [trajectory, keyframes] = graph_of(run);
  std::vector<bool> has_loops(keyframes.size(), false);
  for (std::size_t k = 1; k < keyframes.size(); k += 2) trajectory.edges[k - 1].is_break = true;
  for (const std::size_t k : {2U, 13U, 101U}) has_loops[k] = true;  // 2 is behind the break at 1
  coarsen(20, has_loops, &keyframes, &trajectory);
  EXPECT_EQ(keyframes.size(), 20U);
  for (const std::size_t k : {1U, 13U, 101U}) {
    EXPECT_NE(std::find(keyframes.begin(), keyframes.end(), k), keyframes.end()) << k;
  }
  for (const OdometryEdge& edge : trajectory.edges) EXPECT_TRUE(edge.is_break);
}

TEST(Coarsening, JoinedOdometryIsAsUncertainAsItsParts) {
  SyntheticRun run;
  const std::vector<OdometryEdge> edges = run.edges();
  const OdometryNoise noise{0.02, 0.03, 0.0, 0.0, 0.0, 1.0};
  OdometryEdge joined = edges[10];
  Mat6 covariance = odometry_covariance(edges[10], noise);
  for (std::size_t i = 11; i < 30; ++i) {
    joined = join(joined, edges[i]);
    const Mat6 carry = transport(edges[i].T_from_to);
    covariance = (carry * covariance * carry.transpose() + odometry_covariance(edges[i], noise)).eval();
  }
  EXPECT_LT((odometry_covariance(joined, noise) - covariance).norm(), 1e-12 + 1e-9 * covariance.norm());
  EXPECT_GT(joined.path_m, 10.0 * edges[10].path_m);
  // A loop over the stretch asks as much of the odometry, whether it is joined or not.
  LoopClosure closure = run.exact_loop(30, 10);
  closure.T_match_query.t += Vec3(0.2, -0.1, 0.1);
  const PathNoise path(run.odometry(), edges);
  const std::vector<SE3> ends{run.odometry(10), run.odometry(30)};
  const std::vector<OdometryEdge> edge{joined};
  const double apart = path.explaining_factor(graph_loop(closure), noise, 100.0);
  const double together = PathNoise(ends, edge).explaining_factor(*make_graph_loop(closure, 1, 0), noise, 100.0);
  EXPECT_GT(apart, 0.1);
  EXPECT_NEAR(together, apart, 0.02 * apart);
}

TEST(Coarsening, JoinedOdometryRemembersWhatSolvedMotionsTookThePlaceOf) {
  SyntheticRun run;
  std::vector<OdometryEdge> edges = run.edges();
  EXPECT_TRUE(measured_edges(edges).empty());
  SolvedMotion motion;
  motion.T_from_to = edges[11].T_from_to * SE3(Quaternion::Identity(), Vec3(0.1, 0.0, 0.0));
  motion.path_m = 0.5;
  for (int i = 0; i < 2; ++i) ASSERT_TRUE(edges[11].refine(motion));
  const OdometryEdge joined = join(join(edges[10], edges[11]), edges[12]);
  EXPECT_LT((joined.T_from_to.t - (edges[10].T_from_to * motion.T_from_to * edges[12].T_from_to).t).norm(), 1e-12);
  const std::vector<OdometryEdge> measured = measured_edges({joined, edges[13]});
  ASSERT_EQ(measured.size(), 2U);
  const SE3 T_odom = run.odometry(10).inverse() * run.odometry(13);
  EXPECT_LT((measured[0].T_from_to.t - T_odom.t).norm(), 1e-12);
  EXPECT_LT(measured[0].path_m, joined.path_m);
  EXPECT_EQ(measured[1].T_from_to.t, edges[13].T_from_to.t);
}

TEST(Coarsening, AJumpThatTheSourceVouchesForIsNoneOfTheJoinedOdometry) {
  SyntheticRun run;
  std::vector<OdometryEdge> edges = run.edges();
  edges[10].suspected_jump = Vec6::Constant(0.1);
  edges[10].covariance = Mat6(1e-6 * Mat6::Identity());
  const OdometryNoise noise{0.02, 0.03, 0.0, 0.0, 0.0, 1.0};
  EXPECT_TRUE(expected_jump(join(edges[10], edges[11]), noise).isZero(0.0));
  edges[10].covariance.reset();
  EXPECT_FALSE(expected_jump(join(edges[10], edges[11]), noise).isZero(0.0));
}

TEST(Coarsening, ALoopMovesWithTheVertexOfItsKeyframe) {
  SyntheticRun run;
  const GraphLoop loop = graph_loop(run.exact_loop(150, 50));
  const SE3 T_48_50 = run.truth(48).inverse() * run.truth(50), T_147_150 = run.truth(147).inverse() * run.truth(150);
  const GraphLoop moved = carried(loop, {7, T_48_50}, {9, T_147_150});
  EXPECT_EQ(moved.from, 7);
  EXPECT_EQ(moved.to, 9);
  const SE3 expected = run.truth(48).inverse() * run.truth(147);
  EXPECT_LT((expected.inverse() * moved.T_from_to).t.norm(), 1e-9);
  // What turns the loop's end moves the vertex at arm's length.
  EXPECT_GT(moved.covariance.diagonal().head<3>().sum(), loop.covariance.diagonal().head<3>().sum());
}

}  // namespace
}  // namespace semantic_topo_loop::core
