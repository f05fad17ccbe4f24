#include "semantic_topo_loop/pose_graph/pose_graph.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <limits>
#include <map>
#include <set>
#include <string>

#include "geometry/relative_pose.h"
#include "pose_graph/graph_state.h"
#include "pose_graph/rejection/loop_rejection.h"
#include "pose_graph/solver/graph_solver.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "support/synthetic_run.h"
#include "tools/perturbation/perturbation.h"

namespace semantic_topo_loop::core {
namespace {

int count_kept(const std::vector<LoopVerdict>& verdicts) {
  int kept = 0;
  for (const LoopVerdict& verdict : verdicts) kept += verdict.kept ? 1 : 0;
  return kept;
}

TEST(SolveGraph, SquareWithALoopSharesTheErrorEvenly) {
  // Four sides of a square, each measured 1 % too long in a translation-only world; the fourth vertex is told to be
  // at the first again. With equal weights each of the five edges takes a fifth of the misclosure.
  std::vector<SE3> vertices(1);
  std::vector<GraphEdge> edges;
  const std::vector<Vec3> sides{{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {-1.0, 0.0, 0.0}, {0.0, -0.9, 0.0}};
  Mat6 sqrt_info = Mat6::Identity();
  sqrt_info.bottomRightCorner<3, 3>() *= 1e6;  // rotations are certain
  for (int i = 0; i < 4; ++i) {
    const SE3 side(Quaternion::Identity(), sides[static_cast<std::size_t>(i)]);
    vertices.push_back(vertices.back() * side);
    edges.push_back({i, i + 1, side, sqrt_info, 1.0, false});
  }
  edges.push_back({0, 4, SE3(), sqrt_info, 1.0, true});
  const GraphSolution solution = solve_graph(edges, {}, &vertices);
  ASSERT_TRUE(solution.usable);
  EXPECT_NEAR(solution.initial_cost, 0.5 * 0.01, 1e-9);
  EXPECT_NEAR(solution.final_cost, 0.5 * 0.01 / 5.0, 1e-9);
  for (int i = 1; i <= 4; ++i) {
    Vec3 expected = Vec3::Zero();
    for (int j = 0; j < i; ++j) expected += sides[static_cast<std::size_t>(j)] - Vec3(0.0, 0.02, 0.0);
    EXPECT_LT((vertices[static_cast<std::size_t>(i)].t - expected).norm(), 1e-6) << i;
  }
}

TEST(SolveGraph, WeightCountsAsSoManyEdges) {
  const auto middle = [](double weight) {
    std::vector<SE3> vertices(2);
    const SE3 one(Quaternion::Identity(), Vec3(1.0, 0.0, 0.0)), zero;
    solve_graph({{0, 1, zero, Mat6::Identity(), 1.0, false}, {0, 1, one, Mat6::Identity(), weight, false}}, {},
                &vertices);
    return vertices[1].t.x();
  };
  EXPECT_NEAR(middle(1.0), 0.5, 1e-6);
  EXPECT_NEAR(middle(3.0), 0.75, 1e-6);
  EXPECT_NEAR(middle(0.0), 0.0, 1e-12);
}

TEST(SolveGraph, ConvergesInAFewStepsFromAFarStart) {
  // Wrong derivatives would need many more steps, or fail.
  Random random(11);
  std::vector<SE3> truth{random_motion(&random, 1.0, 1.0)};
  std::vector<GraphEdge> edges;
  for (int i = 0; i < 20; ++i) {
    truth.push_back(truth.back() * random_motion(&random, 1.0, 0.5));
    edges.push_back({i, i + 1, truth[truth.size() - 2].inverse() * truth.back(), Mat6::Identity(), 1.0, false});
  }
  edges.push_back({0, 20, truth.front().inverse() * truth.back(), Mat6::Identity(), 1.0, false});
  std::vector<SE3> vertices = truth;
  for (std::size_t i = 1; i < vertices.size(); ++i) vertices[i] = vertices[i] * random_motion(&random, 0.3, 0.3);
  GraphSolverOptions options;
  options.max_iterations = 8;
  options.function_tolerance = 1e-14;
  ASSERT_TRUE(solve_graph(edges, options, &vertices).usable);
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    EXPECT_LT((truth[i].inverse() * vertices[i]).t.norm(), 1e-6) << i;
    EXPECT_LT(rotation_angle(truth[i].q, vertices[i].q), 1e-6) << i;
  }
}

TEST(SolveGraph, AnUnusableProblemLeavesThePosesAlone) {
  std::vector<SE3> vertices(2);
  vertices[1].t.x() = 1.0;
  GraphEdge edge{0, 1, SE3(), Mat6::Identity(), 1.0, false};
  edge.sqrt_info(0, 0) = std::numeric_limits<double>::quiet_NaN();
  const GraphSolution solution = solve_graph({edge}, {}, &vertices);
  EXPECT_FALSE(solution.usable);
  EXPECT_FALSE(solution.message.empty());
  EXPECT_EQ(vertices[1].t.x(), 1.0);
}

// A path of no length would make all of these loops right.
TEST(PoseGraph, PlacesPassedAgainDoNotDrawThePathTogether) {
  for (const std::uint64_t seed : {3, 4}) {
    SyntheticRun run;
    run.drift(0.02, 0.005, seed);
    std::vector<LoopClosure> loops;
    for (int k = run.round(); k < run.size(); k += 5) {
      loops.push_back(run.loop(k, k - run.round(), Vec6::Zero(), 1e-2, 1e-2));
    }
    EXPECT_LT(run.worst_error_m(finish(run, loops).graph.keyframes()), 0.5 * run.worst_odometry_error_m()) << seed;
  }
}

TEST(PoseGraph, WithoutLoopsTheMapIsTheOdometry) {
  SyntheticRun run;
  run.drift(0.01, 0.005, 1);
  const FinishedRun finished = finish(run, {});
  EXPECT_EQ(finished.changes, 0);
  EXPECT_EQ(finished.graph.T_map_odom().t, Vec3::Zero());
  const auto keyframes = finished.graph.keyframes();
  ASSERT_EQ(keyframes.size(), static_cast<std::size_t>(run.size()));
  for (int k = 0; k < run.size(); ++k) {
    EXPECT_LT((keyframes[static_cast<std::size_t>(k)].T_map_camera.t - run.odometry(k).t).norm(), 1e-12);
  }
}

TEST(PoseGraph, ExactLoopsMakeTheSecondRoundAgreeWithTheFirst) {
  SyntheticRun run;
  Vec6 bias = Vec6::Zero();
  bias << 0.004, 0.002, 0.0, 0.0, 0.0, 0.004;
  run.drift(0.0, 0.0, 1, bias);
  std::vector<LoopClosure> loops;
  for (int k = run.round(); k < run.size(); ++k) loops.push_back(run.exact_loop(k, k - run.round()));
  ASSERT_GT(run.worst_odometry_error_m(), 0.5);
  const FinishedRun finished = finish(run, loops);
  EXPECT_EQ(count_kept(finished.end.loops), run.round());
  const auto keyframes = finished.graph.keyframes();
  for (int k = run.round(); k < run.size(); ++k) {
    const SE3& T_map_query = keyframes[static_cast<std::size_t>(k)].T_map_camera;
    const SE3& T_map_match = keyframes[static_cast<std::size_t>(k - run.round())].T_map_camera;
    const Vec6 e =
        relative_pose_residual(run.truth(k - run.round()), run.truth(k), T_map_match.inverse() * T_map_query);
    EXPECT_LT(e.head<3>().norm(), 0.005) << k;
    EXPECT_LT(e.tail<3>().norm(), 0.005) << k;
  }
}

TEST(PoseGraph, ExactLoopsToATrustedRoundRecoverTheTruth) {
  SyntheticRun run;
  Vec6 bias = Vec6::Zero();
  bias << 0.004, 0.002, 0.0, 0.0, 0.0, 0.004;
  run.drift(0.0, 0.0, 1, bias, run.round());  // the first round is exact, and its source says so
  ASSERT_GT(run.worst_odometry_error_m(), 0.5);
  PoseGraph graph{PoseGraphOptions()};
  for (int k = 0; k < run.size(); ++k) {
    Frame frame = run.frame(k);
    if (k < run.round()) frame.covariance = 1e-10 * Mat6::Identity();
    std::vector<LoopClosure> loops;
    if (k >= run.round()) loops.push_back(run.exact_loop(k, k - run.round()));
    graph.process(frame, loops);
  }
  graph.process(run.end_frame(), {});
  EXPECT_LT(run.worst_error_m(graph.keyframes()), 0.005);
}

TEST(PoseGraph, DriftIsReducedSeveralTimes) {
  // The loops say nothing about an error that both rounds share, so this is judged over several runs.
  double before = 0.0, after = 0.0;
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    SyntheticRun run;
    run.drift(0.01, 0.006, seed);
    before += run.worst_odometry_error_m();
    after += run.worst_error_m(finish(run, noisy_loops(run, 100 + seed)).graph.keyframes());
  }
  EXPECT_LT(after, before / 2.5);
}

TEST(PoseGraph, GoodOdometryIsNotMadeWorse) {
  double before = 0.0, after = 0.0;
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    SyntheticRun run;
    run.drift(0.0003, 0.0001, seed);
    // Overlapping windows and one common error: fifteen loops that are really one.
    Random random(100 + seed);
    const Vec6 noise = random_tangent(&random, kSigma_m, kSigma_rad);
    std::vector<LoopClosure> loops;
    for (int k = 150; k < 180; k += 2) loops.push_back(run.loop(k, k - run.round(), noise, kSigma_m, kSigma_rad, 80));
    before += run.worst_odometry_error_m();
    after += run.worst_error_m(finish(run, loops).graph.keyframes());
  }
  EXPECT_LT(after, 1.3 * before);
  EXPECT_LT(after / 5.0, 0.012) << "a loop's own error is 0.035 m";
}

TEST(PoseGraph, GncRejectsFalseLoopsThatNoneBelieves) {
  SyntheticRun run;
  run.drift(0.004, 0.002, 4);
  std::vector<LoopClosure> loops = noisy_loops(run, 5);
  const std::size_t right = loops.size();
  Random random(6);
  for (int i = 0; i < 6; ++i) {
    const int query = 115 + 12 * i;
    loops.push_back(run.loop(query, query - 90, random_tangent(&random, 0.7, 0.5), kSigma_m, kSigma_rad));
  }
  PoseGraphOptions options;
  const FinishedRun gnc = finish(run, loops, options);
  options.robust = "none";
  const FinishedRun none = finish(run, loops, options);
  ASSERT_EQ(gnc.end.loops.size(), loops.size());
  EXPECT_EQ(count_kept(none.end.loops), static_cast<int>(loops.size()));
  for (const LoopVerdict& verdict : gnc.end.loops) {
    const bool is_false = verdict.query_keyframe_id - verdict.match_keyframe_id == 90;
    EXPECT_EQ(verdict.kept, !is_false) << verdict.query_keyframe_id;
  }
  EXPECT_EQ(count_kept(gnc.end.loops), static_cast<int>(right));
  const double gnc_error = run.worst_error_m(gnc.graph.keyframes());
  EXPECT_LT(gnc_error, run.worst_odometry_error_m());
  EXPECT_GT(run.worst_error_m(none.graph.keyframes()), 3.0 * gnc_error);
}

TEST(PoseGraph, LossesLimitTheDamageOfFalseLoops) {
  SyntheticRun run;
  run.drift(0.004, 0.002, 4);
  std::vector<LoopClosure> loops = noisy_loops(run, 5);
  Random random(6);
  for (const int query : {130, 160}) {
    loops.push_back(run.loop(query, query - 90, random_tangent(&random, 0.7, 0.5), kSigma_m, kSigma_rad));
  }
  PoseGraphOptions options;
  options.robust = "none";
  const double none = run.worst_error_m(finish(run, loops, options).graph.keyframes());
  for (const std::string robust : {"huber", "cauchy"}) {
    options.robust = robust;
    EXPECT_LT(run.worst_error_m(finish(run, loops, options).graph.keyframes()), 0.7 * none) << robust;
  }
}

TEST(PoseGraph, ABreakIsBridgedByLoops) {
  SyntheticRun run;
  run.drift(0.001, 0.0005, 7);
  Random random(8);
  run.restart(120, random_motion(&random, 3.0, 1.5));
  const FinishedRun finished = finish(run, noisy_loops(run, 9), {}, {120});
  ASSERT_GT(run.worst_odometry_error_m(), 1.0);
  EXPECT_LT(run.worst_error_m(finished.graph.keyframes()), 0.08);
}

TEST(PoseGraph, ARestartAnywhereIsPutWhereItsLoopsHaveIt) {
  // The loops come at once, as of two maps that are joined. One in three is wrong.
  for (const double angle : {0.5, 1.5, 3.0}) {
    SyntheticRun run;
    run.drift(0.004, 0.002, 7);
    run.restart(run.round(), SE3(so3_exp(angle * Vec3(0.6, -0.64, 0.48)), Vec3(80.0, -60.0, 20.0)));
    PoseGraph graph{PoseGraphOptions()};
    Random random(8);
    std::vector<LoopClosure> loops;
    for (int k = run.round(); k < run.size(); ++k) {
      if (k % 4 != 0) continue;
      const bool is_right = k % 3 != 0;
      const Vec6 noise = is_right ? random_tangent(&random, kSigma_m, kSigma_rad) : random_tangent(&random, 3.0, 1.0);
      loops.push_back(run.loop(k, k - run.round(), noise, kSigma_m, kSigma_rad));
    }
    for (int k = 0; k < run.size(); ++k) {
      Frame frame = run.frame(k);
      frame.is_break = k == run.round();
      graph.process(frame, {});
    }
    const MapCorrection correction = graph.process(run.end_frame(), loops);
    ASSERT_EQ(correction.loops.size(), loops.size());
    for (const LoopVerdict& verdict : correction.loops)
      EXPECT_TRUE(!verdict.kept || verdict.query_keyframe_id % 3 != 0);
    EXPECT_GE(3 * count_kept(correction.loops), static_cast<int>(loops.size()));
    EXPECT_LT(run.worst_error_m(graph.keyframes()), 0.15) << angle << " rad";
  }
}

TEST(PoseGraph, TheSourcesCovarianceIsUsed) {
  // The odometry errs in one motion only and its source says so: the correction belongs there.
  SyntheticRun run;
  Vec6 slip = Vec6::Zero();
  slip.head<3>() = Vec3(0.3, -0.2, 0.0);
  run.drift(0.0, 0.0, 1, slip, 60, 61);
  PoseGraph graph{PoseGraphOptions()};
  for (int k = 0; k < run.size(); ++k) {
    Frame frame = run.frame(k);
    frame.covariance = (k == 60 ? 0.1 : 1e-8) * Mat6::Identity();
    std::vector<LoopClosure> loops;
    if (k >= 150 && k % 10 == 0) loops.push_back(run.exact_loop(k, k - run.round()));
    graph.process(frame, loops);
  }
  graph.process(run.end_frame(), {});
  EXPECT_LT(run.worst_error_m(graph.keyframes()), 0.005);
}

SolvedMotion true_motion(const SyntheticRun& run, int from, int to) {
  SolvedMotion motion;
  motion.from_keyframe_id = from;
  motion.to_keyframe_id = to;
  motion.T_from_to = run.truth(from).inverse() * run.truth(to);
  motion.path_m = motion.T_from_to.t.norm();
  motion.rotation_rad = rotation_angle(motion.T_from_to.q, Quaternion::Identity());
  return motion;
}

TEST(PoseGraph, SolvedMotionsTakeThePlaceOfTheOdometrys) {
  SyntheticRun run;
  run.drift(0.01, 0.005, 1);
  PoseGraph graph{PoseGraphOptions()};
  for (int k = 0; k < run.size(); ++k) {
    std::vector<SolvedMotion> motions;
    for (int from = std::max(0, k - 5); from + 1 < k; ++from) motions.push_back(true_motion(run, from, from + 1));
    graph.refine(motions);
    graph.process(run.frame(k), {});
  }
  graph.refine({true_motion(run, run.size() - 2, run.size() - 1)});
  EXPECT_TRUE(graph.process(run.end_frame(), {}).changed);
  ASSERT_GT(run.worst_odometry_error_m(), 0.1);
  EXPECT_LT(run.worst_error_m(graph.keyframes()), 1e-6);
}

/// @param motions that were solved for between all keyframes   @return largest distance from the truth in the end
double worst_error_with(const SyntheticRun& run, const std::vector<SolvedMotion>& motions,
                        const std::vector<LoopClosure>& loops) {
  PoseGraph graph{PoseGraphOptions()};
  for (int k = 0; k < run.size(); ++k) {
    graph.process(run.frame(k), loops_at(k, loops));
    if (k > 0) graph.refine({motions[static_cast<std::size_t>(k - 1)]});
  }
  graph.process(run.end_frame(), {});
  return run.worst_error_m(graph.keyframes());
}

TEST(PoseGraph, LoopsTellWhetherTheOdometrysOrTheSolvedMotionsAreBetter) {
  SyntheticRun good, bad;
  good.drift(0.0005, 0.0002, 1);
  bad.drift(0.02, 0.01, 2);
  std::vector<SolvedMotion> right, wrong;
  for (int k = 1; k < good.size(); ++k) {
    right.push_back(true_motion(good, k - 1, k));
    wrong.push_back(right.back());
    wrong.back().T_from_to = bad.odometry(k - 1).inverse() * bad.odometry(k);
  }
  EXPECT_GT(worst_error_with(good, wrong, {}), 0.1) << "none tells";
  const std::vector<LoopClosure> loops = noisy_loops(good, 3, 2);
  EXPECT_LT(worst_error_with(good, wrong, loops), 0.03);
  EXPECT_LT(worst_error_with(bad, right, loops), 0.03);
}

TEST(PoseGraph, TheStateHasTheMotionsThatItsPosesRestOn) {
  SyntheticRun good, bad;
  good.drift(0.0005, 0.0002, 1);
  bad.drift(0.02, 0.01, 2);
  PoseGraph graph{PoseGraphOptions()};
  const std::vector<LoopClosure> loops = noisy_loops(good, 3, 2);
  for (int k = 0; k < good.size(); ++k) {
    graph.process(good.frame(k), loops_at(k, loops));
    if (k == 0) continue;
    SolvedMotion wrong = true_motion(good, k - 1, k);
    wrong.T_from_to = bad.odometry(k - 1).inverse() * bad.odometry(k);
    graph.refine({wrong});
  }
  graph.process(good.end_frame(), {});
  const GraphState state = graph.state();
  ASSERT_EQ(static_cast<int>(state.edges.size()), good.size() - 1);
  for (int k = 1; k < good.size(); ++k) {
    const SE3 T_from_to = good.odometry(k - 1).inverse() * good.odometry(k);
    EXPECT_LT((state.edges[static_cast<std::size_t>(k - 1)].T_from_to.t - T_from_to.t).norm(), 1e-12) << k;
  }
}

TEST(PoseGraph, TheStateHasTheSuspectedJumpsAtAnyTime) {
  SyntheticRun run;
  run.drift(0.0005, 0.0002, 3);
  run.restart(80, SE3(so3_exp(Vec3(0.02, 0.05, -0.04)), Vec3(0.3, -0.1, 0.1)));
  PoseGraph graph{PoseGraphOptions()};
  for (int k = 0; k < 100; ++k) graph.process(run.frame(k), {});
  const Vec6 jump = graph.state().edges[79].suspected_jump;
  EXPECT_GT(jump.head<3>().norm(), 0.1);
  for (int k = 100; k < run.size(); ++k) graph.process(run.frame(k), {});
  graph.process(run.end_frame(), {});
  EXPECT_EQ(graph.state().edges[79].suspected_jump, jump);
}

/// A frame as a session counts it that goes on with a run's map.
Frame later(Frame frame, const SyntheticRun& before) {
  frame.frame_id += before.size() + 1;
  frame.keyframe_id += before.size();
  return frame;
}

LoopClosure later(LoopClosure loop, const SyntheticRun& before, bool leads_to_the_map) {
  loop.query_keyframe_id += before.size();
  for (auto frame : {&LoopClosure::query_frame, &LoopClosure::query_begin, &LoopClosure::query_end}) {
    loop.*frame += before.size() + 1;
  }
  if (leads_to_the_map) return loop;
  loop.match_keyframe_id += before.size();
  for (auto frame : {&LoopClosure::match_frame, &LoopClosure::match_begin, &LoopClosure::match_end}) {
    loop.*frame += before.size() + 1;
  }
  return loop;
}

/// The map of a good odometry, and a poor one's session that goes on with it.
TEST(PoseGraph, ALaterSessionsNoiseIsItsOwn) {
  SyntheticRun good, poor;
  good.drift(0.0003, 0.0001, 1);
  poor.drift(0.02, 0.01, 2);
  const FinishedRun first = finish(good, noisy_loops(good, 3, 2));
  const std::vector<LoopClosure> later_loops = noisy_loops(poor, 4, 2);
  const std::vector<KeyframePose> before = first.graph.keyframes();
  PoseGraph second{PoseGraphOptions()};
  second.restore(first.graph.state());
  for (int k = 0; k < poor.size(); ++k) {
    std::vector<LoopClosure> found;
    for (const LoopClosure& loop : loops_at(k, later_loops)) {
      for (const bool leads_to_the_map : {false, true}) found.push_back(later(loop, good, leads_to_the_map));
    }
    second.process(later(poor.frame(k), good), found);
  }
  EXPECT_EQ(second.process(later(poor.end_frame(), good), {}).odometry.stated_edges, 0) << "of this session";
  const std::vector<KeyframePose> after = second.keyframes();
  ASSERT_EQ(after.size(), before.size() + static_cast<std::size_t>(poor.size()));
  double moved = 0.0, worst = 0.0;
  const SE3 T_truth_map = good.truth(0) * before.front().T_map_camera.inverse();
  for (std::size_t k = 0; k < before.size(); ++k) {
    moved = std::max(moved, (after[k].T_map_camera.t - before[k].T_map_camera.t).norm());
    const SE3 T = T_truth_map * after[before.size() + k].T_map_camera;
    worst = std::max(worst, (T.t - poor.truth(static_cast<int>(k)).t).norm());
  }
  EXPECT_GT(poor.worst_odometry_error_m(), 0.3);
  EXPECT_LT(moved, 0.01) << "the map";
  EXPECT_LT(worst, 0.2) << "the session; by the noise of the map it is 0.8 m off";
}

/// An odometry that begins to drift: few loops tell, where the map has many.
TEST(PoseGraph, ALaterSessionsNoiseIsLearntAsOftenAsThatOfTheFirst) {
  SyntheticRun good, session;
  good.drift(0.0003, 0.0001, 1);
  Vec6 bias = Vec6::Zero();
  bias << 0.002, 0.001, 0.0, 0.0, 0.0, 0.0003;
  session.drift(0.0, 0.0, 2, bias, 110);
  const FinishedRun first = finish(good, noisy_loops(good, 3, 2));
  ASSERT_GE(first.graph.size().loops, 40U);
  PoseGraph second{PoseGraphOptions()};
  second.restore(first.graph.state());
  const auto noise_at = [&](int begin, int end) {
    for (int k = begin; k < end; ++k) second.process(later(session.frame(k), good), {});
    std::vector<LoopClosure> found;
    for (int k = end - 2; k <= end; ++k) {
      found.push_back(later(session.exact_loop(k, k - session.round()), good, false));
    }
    const MapCorrection correction = second.process(later(session.frame(end), good), found);
    EXPECT_TRUE(correction.changed) << end;
    const OdometryReport& odometry = correction.odometry;
    return odometry.translation_m + odometry.rotation_rad + odometry.steady_translation + odometry.steady_rotation_rad +
           odometry.scale;
  };
  const double before = noise_at(0, 105);
  EXPECT_GT(noise_at(106, 124), 2.0 * before);
}

/// Two robots whose odometry turns a little all along, one's to the left, the other's to the right.
TEST(PoseGraph, OfJoinedMapsEachOdometryHasErrorsOfItsOwn) {
  GraphState joined;
  std::array<SyntheticRun, 2> runs;
  for (const int robot : {0, 1}) {
    SyntheticRun& run = runs.at(static_cast<std::size_t>(robot));
    Vec6 turn = Vec6::Zero();
    turn(5) = robot == 0 ? 0.003 : -0.003;
    run.drift(1e-4, 1e-5, 1, turn);
    PoseGraph graph{PoseGraphOptions()};
    for (int k = 0; k < run.size(); ++k) {
      std::vector<LoopClosure> loops;
      if (k >= 110 && k < 120) loops.push_back(run.exact_loop(k, k - run.round()));
      if (robot == 0) {
        graph.process(run.frame(k), loops);
      } else {
        for (LoopClosure& loop : loops) loop = later(loop, runs[0], false);
        graph.process(later(run.frame(k), runs[0]), loops);
      }
    }
    joined.append(graph.state());
  }
  PoseGraph graph{PoseGraphOptions()};
  graph.restore(joined);
  std::vector<LoopClosure> between;
  for (int k = 0; k < 5; ++k) between.push_back(later(runs[1].exact_loop(k, k), runs[0], true));
  graph.process(later(later(runs[1].end_frame(), runs[0]), runs[1]), between);
  const std::vector<KeyframePose> keyframes = graph.keyframes();
  for (const int robot : {0, 1}) {
    const SyntheticRun& run = runs.at(static_cast<std::size_t>(robot));
    const auto first = static_cast<std::size_t>(robot * runs[0].size());
    std::vector<KeyframePose> own;
    for (int k = 0; k < run.size(); ++k) {
      own.push_back(keyframes[first + static_cast<std::size_t>(k)]);
      own.back().frame_id = k;
    }
    EXPECT_GT(run.worst_odometry_error_m(), 1.0);
    EXPECT_LT(run.worst_error_m(own), 0.05) << "robot " << robot << "; with one for both 0.8 and 0.2 m";
  }
}

TEST(PoseGraph, AFaultlessOdometryIsHardlyBentByLoopsOrBoxes) {
  double worst = 0.0;
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    const SyntheticRun exact;
    SyntheticRun boxes;
    boxes.drift(0.0005, 0.0002, seed);
    std::vector<SolvedMotion> motions;
    for (int k = 1; k < exact.size(); ++k) {
      motions.push_back(true_motion(exact, k - 1, k));
      motions.back().T_from_to = boxes.odometry(k - 1).inverse() * boxes.odometry(k);
    }
    worst = std::max(worst, worst_error_with(exact, motions, noisy_loops(exact, seed, 2)));
  }
  EXPECT_LT(worst, 0.006) << "a loop's error is 0.035 m";
}

TEST(PoseGraph, WhatNoNeighboursOrAKnownNoiseTellIsNotReplaced) {
  SyntheticRun run;
  run.drift(0.01, 0.005, 1);
  PoseGraph graph{PoseGraphOptions()};
  for (int k = 0; k < 20; ++k) {
    Frame frame = run.frame(k);
    frame.is_break = k == 5;
    if (k == 8) frame.covariance = 1e-4 * Mat6::Identity();
    graph.process(frame, {});
  }
  std::vector<SolvedMotion> wrong(6, true_motion(run, 10, 11));
  wrong[0].T_from_to.t.x() = std::numeric_limits<double>::quiet_NaN();
  wrong[1].T_from_to.q.coeffs().setZero();
  wrong[2].path_m = std::numeric_limits<double>::infinity();
  wrong[3].missed.frozen_s = -1.0;
  wrong[4].missed.slipped_s = std::numeric_limits<double>::quiet_NaN();
  wrong[5].missed.slipped_s = 1.0;  // of no covariance
  graph.refine(wrong);
  graph.refine({true_motion(run, 4, 5), true_motion(run, 7, 8), true_motion(run, 2, 4), true_motion(run, 3, 2),
                true_motion(run, 19, 20), true_motion(run, 3, 3), SolvedMotion()});
  EXPECT_FALSE(graph.process(run.end_frame(), {}).changed);
}

TEST(PoseGraph, LoopsMendWhatAFrozenOdometryMissed) {
  // The odometry stood still for a second; what was solved for is half a metre off, which only the loops tell.
  SyntheticRun run;
  run.drift(0.0003, 0.0001, 3);
  SolvedMotion frozen = true_motion(run, 60, 61);
  frozen.T_from_to = frozen.T_from_to * SE3(so3_exp(Vec3(0.0, 0.05, 0.1)), Vec3(0.4, -0.3, 0.0));
  frozen.delay_s = 0.06;
  frozen.noise.drift_mps = 0.012;
  const auto worst_error = [&](double frozen_s, OdometryReport* report) {
    frozen.missed.frozen_s = frozen_s;
    frozen.missed.covariance = isotropic_covariance(0.36, 0.36);
    PoseGraph graph{PoseGraphOptions()};
    const std::vector<LoopClosure> loops = noisy_loops(run, 3, 2);
    for (int k = 0; k < run.size(); ++k) {
      std::vector<LoopClosure> now;
      for (const LoopClosure& loop : loops) {
        if (loop.query_frame == k) now.push_back(loop);
      }
      if (k == 66) graph.refine({frozen});
      graph.process(run.frame(k), now);
    }
    *report = graph.process(run.end_frame(), {}).odometry;
    return run.worst_error_m(graph.keyframes());
  };
  OdometryReport report;
  EXPECT_LT(worst_error(4.0, &report), 0.06);
  const auto fault =
      std::find_if(report.faults.begin(), report.faults.end(), [](const OdometryFault& f) { return f.frozen_s > 0.0; });
  ASSERT_NE(fault, report.faults.end());
  EXPECT_EQ(fault->from_keyframe_id, 60);
  EXPECT_EQ(fault->to_keyframe_id, 61);
  EXPECT_EQ(fault->frozen_s, 4.0);
  EXPECT_EQ(report.delay_s, 0.06);
  EXPECT_EQ(report.short_term.drift_mps, 0.012);
  EXPECT_FALSE(fault->is_break);
}

TEST(PoseGraph, BadLoopsAreRefusedAndTheRestIsOptimised) {
  SyntheticRun run;
  run.drift(0.005, 0.002, 2);
  std::vector<LoopClosure> good = noisy_loops(run, 3);
  std::vector<LoopClosure> loops = good;
  const auto add = [&](auto change) {
    LoopClosure bad = good[5];
    change(&bad);
    loops.push_back(bad);
  };
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  add([](LoopClosure* loop) { loop->covariance(1, 1) = kNan; });
  add([](LoopClosure* loop) { loop->covariance(1, 1) = -1.0; });
  add([](LoopClosure* loop) { loop->covariance.setZero(); });
  add([](LoopClosure* loop) { loop->T_match_query.t.x() = kNan; });
  add([](LoopClosure* loop) { loop->T_match_query.q = Quaternion(0.0, 0.0, 0.0, 0.0); });
  add([](LoopClosure* loop) { loop->match_keyframe_id = 100000; });
  add([](LoopClosure* loop) { loop->match_keyframe_id = loop->query_keyframe_id; });
  const FinishedRun finished = finish(run, loops), clean = finish(run, good);
  EXPECT_EQ(finished.end.loops.size(), loops.size());
  EXPECT_EQ(count_kept(finished.end.loops), count_kept(clean.end.loops));
  EXPECT_NEAR(run.worst_error_m(finished.graph.keyframes()), run.worst_error_m(clean.graph.keyframes()), 1e-9);
}

TEST(PoseGraph, RejectedCandidatesAndLoopsIntoAnEarlierMapAreIgnored) {
  SyntheticRun run;
  LoopClosure rejected = run.exact_loop(150, 50), into_earlier = rejected;
  rejected.accepted = false;
  into_earlier.T_earlier_match = SE3();  // whose keyframes have numbers of their own
  EXPECT_EQ(finish(run, {rejected, into_earlier}).changes, 0);
}

TEST(PoseGraph, CopiesOfALoopCountOnce) {
  SyntheticRun run;
  run.drift(0.005, 0.002, 2);
  const std::vector<LoopClosure> once = noisy_loops(run, 3);
  std::vector<LoopClosure> often = once;
  for (int i = 0; i < 10; ++i) often.push_back(once[4]);
  const auto a = finish(run, once).graph.keyframes(), b = finish(run, often).graph.keyframes();
  EXPECT_LT((a.back().T_map_camera.t - b.back().T_map_camera.t).norm(), 0.02);
}

TEST(PoseGraph, OfLoopsThatRepeatOthersTheLastAreRemembered) {
  SyntheticRun run;
  run.drift(0.005, 0.002, 2);
  std::vector<LoopClosure> loops = noisy_loops(run, 3);
  const std::size_t once = loops.size();
  const int at = static_cast<int>(loops.back().query_keyframe_id);
  loops.resize(once + 3000, loops.back());
  PoseGraph graph{PoseGraphOptions()};
  for (int k = 0; k <= at; ++k) graph.process(run.frame(k), loops_at(k, loops));
  graph.process(run.end_frame(), {});
  EXPECT_GE(graph.size().loops, once / 2);
  EXPECT_LE(graph.state().loops.size(), once + 1000);
}

TEST(PoseGraph, BadFramesAreLeftOut) {
  SyntheticRun run(40);
  PoseGraph graph{PoseGraphOptions()};
  for (int k = 0; k < run.size(); ++k) {
    Frame frame = run.frame(k);
    if (k == 20) frame.T_odom_camera.t.x() = std::numeric_limits<double>::quiet_NaN();
    if (k == 30) frame.keyframe_id = 29;  // a keyframe of that id exists
    if (k == 31) frame.covariance = std::numeric_limits<double>::quiet_NaN() * Mat6::Identity();
    graph.process(frame, k == 70 ? std::vector<LoopClosure>{run.exact_loop(70, 30), run.exact_loop(70, 31)}
                                 : std::vector<LoopClosure>{});
  }
  graph.process(run.end_frame(), {});
  const auto keyframes = graph.keyframes();
  EXPECT_EQ(keyframes.size(), static_cast<std::size_t>(run.size()) - 2);
  for (const KeyframePose& keyframe : keyframes) EXPECT_TRUE(keyframe.T_map_camera.is_finite());
  EXPECT_LT(run.worst_error_m(keyframes), 0.01);
}

TEST(PoseGraph, SameInputGivesTheSameBytes) {
  SyntheticRun run;
  run.drift(0.005, 0.003, 12);
  const auto loops = noisy_loops(run, 13);
  const auto a = finish(run, loops).graph.keyframes(), b = finish(run, loops).graph.keyframes();
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(std::memcmp(a[i].T_map_camera.t.data(), b[i].T_map_camera.t.data(), 3 * sizeof(double)), 0) << i;
    EXPECT_EQ(std::memcmp(a[i].T_map_camera.q.coeffs().data(), b[i].T_map_camera.q.coeffs().data(), 4 * sizeof(double)),
              0)
        << i;
  }
}

TEST(PoseGraph, TheWorldOfTheOdometryDoesNotMatter) {
  SyntheticRun run;
  run.drift(0.005, 0.003, 14);
  const auto loops = noisy_loops(run, 15);
  const auto a = finish(run, loops).graph.keyframes();
  Random random(16);
  run.move_world(random_motion(&random, 5.0, 2.0));
  const auto b = finish(run, loops).graph.keyframes();
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 1; i < a.size(); ++i) {
    const SE3 a_motion = a.front().T_map_camera.inverse() * a[i].T_map_camera;
    const SE3 b_motion = b.front().T_map_camera.inverse() * b[i].T_map_camera;
    EXPECT_LT((a_motion.t - b_motion.t).norm(), 1e-4) << i;
    EXPECT_LT(rotation_angle(a_motion.q, b_motion.q), 1e-4) << i;
  }
}

TEST(PoseGraph, CorrectionsAreConsistentAndTheFirstKeyframeStays) {
  SyntheticRun run;
  run.drift(0.008, 0.004, 17);
  const auto loops = noisy_loops(run, 18);
  PoseGraph graph{PoseGraphOptions()};
  SE3 T_map_odom;
  int changes = 0;
  std::map<std::int64_t, KeyframePose> told;
  for (int k = 0; k < run.size(); ++k) {
    const MapCorrection correction = graph.process(run.frame(k), loops_at(k, loops));
    EXPECT_EQ(correction.frame_id, k);
    EXPECT_EQ(correction.T_map_odom_old.t, T_map_odom.t);
    T_map_odom = correction.T_map_odom;
    if (!correction.changed) {
      EXPECT_TRUE(correction.keyframes.empty());
      EXPECT_EQ(correction.T_map_odom_old.t, correction.T_map_odom.t);
      continue;
    }
    ++changes;
    for (const KeyframePose& keyframe : correction.keyframes) told[keyframe.keyframe_id] = keyframe;
    ASSERT_EQ(told.size(), static_cast<std::size_t>(k) + 1);
    EXPECT_EQ(correction.valid_to_keyframe_id, k);
    EXPECT_EQ(told[0].T_map_camera.t, run.odometry(0).t);
    const SE3 T_map_last = correction.T_map_odom * run.odometry(k);
    EXPECT_LT((T_map_last.t - told[k].T_map_camera.t).norm(), 1e-9);
  }
  EXPECT_GT(changes, 1);
  EXPECT_LT(changes, static_cast<int>(loops.size()) + 1);
}

TEST(PoseGraph, OptionsChangeFromTheNextFrameOn) {
  SyntheticRun run(40);
  run.drift(0.01, 0.006, 1);
  PoseGraphOptions options;
  options.interval_keyframes = options.min_interval_keyframes = 1000;
  PoseGraph graph(options);
  const auto changes_until = [&](int end, int k) {
    int changes = 0;
    for (; k < end; ++k) changes += graph.process(run.frame(k), {run.exact_loop(k, k - run.round())}).changed ? 1 : 0;
    return changes;
  };
  for (int k = 0; k < run.round(); ++k) graph.process(run.frame(k), {});
  EXPECT_EQ(changes_until(60, 40), 0);
  options.interval_keyframes = options.min_interval_keyframes = 1;
  graph.set_options(options);
  EXPECT_EQ(changes_until(80, 60), 20);
}

TEST(PoseGraph, AnEndFrameOptimisesWhatIsPending) {
  SyntheticRun run(40);
  PoseGraphOptions options;
  options.interval_keyframes = options.min_interval_keyframes = 1000;
  const FinishedRun finished = finish(run, {run.exact_loop(70, 30)}, options);
  EXPECT_EQ(finished.changes, 1);
  EXPECT_TRUE(finished.end.changed);
  EXPECT_EQ(finished.end.keyframes.size(), static_cast<std::size_t>(run.size()));
}

TEST(PoseGraph, NothingAtAllIsFine) {
  PoseGraph graph{PoseGraphOptions()};
  Frame end;
  end.is_end = true;
  end.frame_id = 0;
  EXPECT_FALSE(graph.process(end, {}).changed);
  EXPECT_TRUE(graph.keyframes().empty());
}

TEST(PoseGraphOptions, WrongValuesAreNamed) {
  PoseGraphOptions options;
  EXPECT_TRUE(validate(options));
  options.robust = "maybe";
  EXPECT_EQ(validate(options).message(), "parameter 'pose_graph.robust' = 'maybe' must be gnc, cauchy, huber or none");
  options = {};
  options.translation_noise_m = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(validate(options).message(), "parameter 'pose_graph.translation_noise_m' = 'nan' must be > 0");
}

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

TEST(FalseLoops, AreNoneOfThoseThatANoisyOdometryNeedsWhateverMayBeLearnt) {
  SyntheticRun run;
  run.drift(0.001, 0.0005, 4);
  const SE3 error(so3_exp(Vec3(0.7, 0.45, -0.55)), Vec3(1.4, -1.5, 0.7));
  std::vector<LoopClosure> loops;
  for (int k = 60; k < 78; k += 2) {
    LoopClosure wrong = run.exact_loop(k, k - 50);
    wrong.T_match_query = run.truth(k - 50).inverse() * run.truth(10) * error * run.truth(60).inverse() * run.truth(k);
    loops.push_back(wrong);
  }
  for (const double factor_max : {50.0, 140.0, 1000.0}) {
    PoseGraphOptions options;
    options.noise_factor_max = factor_max;
    EXPECT_EQ(count_kept(finish(run, loops, options).end.loops), 0) << factor_max;
  }
  PoseGraphOptions noisy;
  noisy.translation_noise_m = 0.02;
  noisy.rotation_noise_deg = 0.4;
  for (const bool estimates : {true, false}) {
    noisy.estimate_noise = estimates;
    EXPECT_EQ(count_kept(finish(run, loops, noisy).end.loops), 0) << "whatever is stated";
  }
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
  ASSERT_EQ(correction.loops.size(), 1U) << "nothing new is said of the other";
  EXPECT_EQ(correction.loops[0].query_keyframe_id, 79);
  EXPECT_FALSE(correction.loops[0].kept);
  EXPECT_EQ(correction.loops[0].reason, "withdrawn");
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

TEST(LoopClusters, WhatAnEarlierSessionBelievedInTheEndIsDoubtedNoMoreAndWhatItFoundOutIs) {
  ClusterCase data = make_cluster_case(SE3(so3_exp(Vec3(0.3, -0.4, 0.2)), Vec3(0.8, -0.6, 0.4)));
  data.trajectory.session_begins = {static_cast<int>(data.trajectory.T_map_vertex.size())};
  std::vector<bool> settled(data.trajectory.loops.size(), true);
  EXPECT_EQ(audit_clusters(data.trajectory, {}, data.knowledge, settled), data.knowledge.kept);
  std::fill(settled.begin() + static_cast<std::ptrdiff_t>(data.right), settled.end(), false);
  std::vector<bool> right = settled;
  EXPECT_EQ(audit_clusters(data.trajectory, {}, data.knowledge, settled), right);
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

TEST(LoopConsistency, WhatTheOdometryIsKnownToBeOffMakesNoLoopWrong) {
  SyntheticRun run;
  std::vector<GraphLoop> loops;
  for (int k = 150; k < 160; k += 2) loops.push_back(graph_loop(run.exact_loop(k, k - 100)));
  std::vector<OdometryEdge> off = run.edges();
  off[154].T_from_to = off[154].T_from_to * SE3(so3_exp(Vec3(0.0, 0.0, 0.4)), Vec3(0.8, 0.0, 0.0));
  std::vector<OdometryEdge> stated = off, frozen = off;
  stated[154].covariance = isotropic_covariance(0.25, 0.04);
  frozen[154].missed.frozen_s = 3.0;
  frozen[154].missed.covariance = isotropic_covariance(0.2, 0.2);
  const std::vector<bool> all(loops.size(), true);
  EXPECT_NE(LoopConsistency().vote(off, loops), all);
  EXPECT_EQ(LoopConsistency().vote(stated, loops), all);
  EXPECT_EQ(LoopConsistency().vote(frozen, loops), all);
  // What turns on the way moves the end by as much as it is away.
  std::vector<OdometryEdge> turned = run.edges();
  turned[120].T_from_to.q = turned[120].T_from_to.q * so3_exp(Vec3(0.0, 0.0, 0.4));
  turned[120].covariance = isotropic_covariance(1e-6, 0.04);
  const std::vector<GraphLoop> ends{graph_loop(run.exact_loop(100, 0)), graph_loop(run.exact_loop(150, 50))};
  EXPECT_EQ(LoopConsistency().vote(turned, ends), std::vector<bool>(2, true));
}

}  // namespace
}  // namespace semantic_topo_loop::core
