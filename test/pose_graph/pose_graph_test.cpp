#include "semantic_topo_loop/pose_graph/pose_graph.h"

#include <gtest/gtest.h>

#include <cstring>
#include <limits>
#include <string>

#include "geometry/relative_pose.h"
#include "pose_graph/solver/graph_solver.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "support/synthetic_run.h"

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

TEST(PoseGraph, RejectedCandidatesAreIgnored) {
  SyntheticRun run;
  LoopClosure loop = run.exact_loop(150, 50);
  loop.accepted = false;
  EXPECT_EQ(finish(run, {loop}).changes, 0);
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
    ASSERT_EQ(correction.keyframes.size(), static_cast<std::size_t>(k) + 1);
    EXPECT_EQ(correction.valid_to_keyframe_id, k);
    EXPECT_EQ(correction.keyframes.front().T_map_camera.t, run.odometry(0).t);
    const SE3 T_map_last = correction.T_map_odom * run.odometry(k);
    EXPECT_LT((T_map_last.t - correction.keyframes.back().T_map_camera.t).norm(), 1e-9);
  }
  EXPECT_GT(changes, 1);
  EXPECT_LT(changes, static_cast<int>(loops.size()) + 1);
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

}  // namespace
}  // namespace semantic_topo_loop::core
