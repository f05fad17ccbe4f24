#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <memory>

#include "geometry/relative_pose.h"
#include "pose_graph/graph_state.h"
#include "pose_graph/scale/scaled_trajectory.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "support/synthetic_run.h"

namespace semantic_topo_loop::core {
namespace {

Sim3 random_similarity(Random* random, double translation_m, double rotation_rad) {
  const SE3 T = random_motion(random, translation_m, rotation_rad);
  return Sim3(T, std::exp(0.3 * random->normal()));
}

Sim3 moved(const Sim3& S, const Vec7& step) {
  return Sim3(SE3(so3_exp(step.segment<3>(3)) * S.T.q, S.T.t + step.head<3>()), S.scale * std::exp(step(6)));
}

Mat7 numeric_jacobian(const std::function<Vec7(const Vec7&)>& function) {
  constexpr double kStep = 1e-6;
  Mat7 jacobian;
  for (int i = 0; i < 7; ++i) {
    const Vec7 step = kStep * Vec7::Unit(i);
    jacobian.col(i) = (function(step) - function(-step)) / (2.0 * kStep);
  }
  return jacobian;
}

TEST(RelativeSimilarity, ResidualIsZeroForTheTrueOneAndItsRigidPartInTheUnitOfFrom) {
  Random random(1);
  for (int i = 0; i < 20; ++i) {
    const Sim3 S_world_from = random_similarity(&random, 2.0, 1.0), S_from_to = random_similarity(&random, 1.0, 0.5);
    EXPECT_LT(relative_similarity_terms(S_world_from, S_world_from * S_from_to, S_from_to).residual.norm(), 1e-12);
    Vec7 d;
    d << 0.1, -0.2, 0.3, 0.02, 0.03, -0.04, 0.15;
    const Sim3 S_noisy(S_from_to.T * se3_exp(d.head<6>()), S_from_to.scale * std::exp(d(6)));
    EXPECT_LT((relative_similarity_terms(S_world_from, S_world_from * S_noisy, S_from_to).residual - d).norm(), 1e-12);
  }
}

TEST(RelativeSimilarity, JacobiansAgreeWithNumericOnes) {
  Random random(2);
  for (int trial = 0; trial < 100; ++trial) {
    const Sim3 from = random_similarity(&random, 3.0, 2.0), z = random_similarity(&random, 1.0, 0.6);
    const Sim3 to = from * z * random_similarity(&random, 0.5, trial < 50 ? 0.7 : 1e-5);
    const RelativeSimilarityTerms terms = relative_similarity_terms(from, to, z);
    const Mat7 by_from =
        numeric_jacobian([&](const Vec7& d) { return relative_similarity_terms(moved(from, d), to, z).residual; });
    const Mat7 by_to =
        numeric_jacobian([&](const Vec7& d) { return relative_similarity_terms(from, moved(to, d), z).residual; });
    EXPECT_LT((terms.J_from - by_from).cwiseAbs().maxCoeff(), 1e-5) << trial;
    EXPECT_LT((terms.J_to - by_to).cwiseAbs().maxCoeff(), 1e-5) << trial;
  }
}

TEST(SolveSimilarityGraph, FindsTheSimilaritiesFromExactEdges) {
  Random random(3);
  std::vector<Sim3> truth{random_similarity(&random, 1.0, 1.0)}, vertices = truth;
  std::vector<SimilarityEdge> edges;
  for (int i = 1; i < 12; ++i) {
    truth.push_back(truth.back() * random_similarity(&random, 1.0, 0.5));
    vertices.push_back(truth.back() * random_similarity(&random, 0.2, 0.1));
  }
  for (int i = 1; i < 12; ++i) {
    for (const int from : {i - 1, i / 2}) {
      if (from == i) continue;
      const Sim3 S = truth[static_cast<std::size_t>(from)].inverse() * truth[static_cast<std::size_t>(i)];
      edges.push_back({from, i, S, Mat7::Identity(), 1.0});
    }
  }
  const GraphSolution solution = solve_similarity_graph(edges, {}, &vertices);
  ASSERT_TRUE(solution.usable) << solution.message;
  EXPECT_LT(solution.final_cost, 1e-12);
  for (std::size_t v = 0; v < truth.size(); ++v) {
    EXPECT_LT((vertices[v].T.t - truth[v].T.t).norm(), 1e-6) << v;
    EXPECT_NEAR(vertices[v].scale, truth[v].scale, 1e-6) << v;
  }
  EXPECT_EQ(vertices[0].T.t, truth[0].T.t);
  EXPECT_EQ(vertices[0].scale, truth[0].scale);
}

TEST(SolveSimilarityGraph, RefusesWhatIsNotFiniteAndNamesTheEdge) {
  std::vector<Sim3> vertices(3);
  SimilarityEdge edge{0, 2, Sim3(SE3(), 0.0), Mat7::Identity(), 1.0};
  const GraphSolution solution = solve_similarity_graph({edge}, {}, &vertices);
  EXPECT_FALSE(solution.usable);
  EXPECT_NE(solution.message.find("edge 0 to 2"), std::string::npos) << solution.message;
}

constexpr double kScaleSigma = 0.02;

PoseGraphOptions free_scale() {
  PoseGraphOptions options;
  options.scale = "free";
  return options;
}

/// A run whose odometry's unit grows by 28 % and which drifts a little besides.
SyntheticRun monocular_run() {
  SyntheticRun run;
  run.drift(0.002, 0.001, 5);
  run.drift_scale(0.25);
  return run;
}

std::vector<LoopClosure> monocular_loops(const SyntheticRun& run, bool with_scale = true) {
  Random random(7);
  std::vector<LoopClosure> loops = noisy_loops(run, 11);
  for (LoopClosure& loop : loops) {
    loop = run.in_units(loop);
    loop.scale = with_scale ? loop.scale * std::exp(kScaleSigma * random.normal()) : 1.0;
    if (with_scale) loop.scale_covariance(6) = kScaleSigma * kScaleSigma;
  }
  return loops;
}

TEST(FreeScale, CorrectsAnOdometryWhoseScaleDrifts) {
  const SyntheticRun run = monocular_run();
  const FinishedRun free = finish(run, monocular_loops(run), free_scale());
  const FinishedRun fixed = finish(run, monocular_loops(run));
  const double worst_m = run.worst_error_m(free.graph.keyframes());
  EXPECT_LT(worst_m, 0.2);
  EXPECT_LT(4.0 * worst_m, run.worst_odometry_error_m());
  EXPECT_LT(2.0 * worst_m, run.worst_error_m(fixed.graph.keyframes()));
  for (const KeyframePose& keyframe : free.graph.keyframes()) {
    const double scale_error = keyframe.scale * run.unit(static_cast<int>(keyframe.frame_id));
    EXPECT_NEAR(scale_error, 1.0, 0.06) << keyframe.frame_id;
  }
  EXPECT_EQ(free.graph.keyframes().front().scale, 1.0) << "the first scale is the map's";
  EXPECT_EQ(free.graph.keyframes().front().T_map_camera.t, run.odometry(0).t);
  EXPECT_EQ(free.end.scale, free.graph.keyframes().back().scale);
  for (const KeyframePose& keyframe : fixed.graph.keyframes()) EXPECT_EQ(keyframe.scale, 1.0);
}

/// Loops of a detector that measures no scale: their poses are used all the same.
TEST(FreeScale, LoopsThatStateNoneStillImproveTheMap) {
  const SyntheticRun run = monocular_run();
  const FinishedRun free = finish(run, monocular_loops(run, false), free_scale());
  EXPECT_LT(run.worst_error_m(free.graph.keyframes()), 0.9 * run.worst_odometry_error_m());
}

TEST(FreeScale, KeepsFalseLoopsOut) {
  const SyntheticRun run = monocular_run();
  std::vector<LoopClosure> loops = monocular_loops(run);
  const std::size_t right = loops.size();
  Random random(13);
  for (std::size_t i = 0; i < right; ++i) {
    const int query = run.round() + 12 + 4 * static_cast<int>(i), match = 3 + 7 * static_cast<int>(i) % 80;
    LoopClosure loop = run.loop(query, match, random_tangent(&random, 1.0, 0.7), kSigma_m, kSigma_rad);
    loop.scale = std::exp(0.25 * random.normal());
    loop.scale_covariance(6) = kScaleSigma * kScaleSigma;
    loops.push_back(loop);
  }
  const FinishedRun mixed = finish(run, loops, free_scale());
  const FinishedRun clean = finish(run, monocular_loops(run), free_scale());
  ASSERT_EQ(mixed.end.loops.size(), loops.size());
  int right_kept = 0;
  for (const LoopVerdict& verdict : mixed.end.loops) {
    const bool is_right = verdict.query_keyframe_id - verdict.match_keyframe_id == run.round();
    right_kept += is_right && verdict.kept ? 1 : 0;
    EXPECT_TRUE(is_right || !verdict.kept) << verdict.query_keyframe_id << " " << verdict.match_keyframe_id;
  }
  EXPECT_GT(right_kept, static_cast<int>(right) / 2);
  EXPECT_LT(run.worst_error_m(mixed.graph.keyframes()), 1.7 * run.worst_error_m(clean.graph.keyframes()));
}

/// A loop of the right pose but a scale that no other states.
TEST(FreeScale, ALoopOfAnotherScaleIsNotKept) {
  const SyntheticRun run = monocular_run();
  std::vector<LoopClosure> loops = monocular_loops(run);
  loops[4].scale *= 1.4;
  const FinishedRun finished = finish(run, loops, free_scale());
  for (const LoopVerdict& verdict : finished.end.loops) {
    EXPECT_FALSE(verdict.kept && verdict.query_keyframe_id == loops[4].query_keyframe_id);
  }
  EXPECT_LT(run.worst_error_m(finished.graph.keyframes()), 0.2);
}

TEST(FreeScale, ARestartAnywhereIsPutWhereItsLoopsHaveIt) {
  for (const double angle : {0.5, 1.5, 3.0}) {
    SyntheticRun run = monocular_run();
    run.restart(run.round(), SE3(so3_exp(angle * Vec3(0.6, -0.64, 0.48)), Vec3(80.0, -60.0, 20.0)));
    PoseGraph graph(free_scale());
    for (int k = 0; k < run.size(); ++k) {
      Frame frame = run.frame(k);
      frame.is_break = k == run.round();
      graph.process(frame, {});
    }
    const MapCorrection correction = graph.process(run.end_frame(), monocular_loops(run));
    for (const LoopVerdict& verdict : correction.loops) EXPECT_TRUE(verdict.kept) << verdict.reason;
    EXPECT_LT(run.worst_error_m(graph.keyframes()), 0.4) << angle << " rad";
  }
}

/// Few right loops, and a place taken for another.
TEST(FreeScale, AClusterThatTheOdometryDoesNotLetExpectGoes) {
  SyntheticRun run = monocular_run();
  std::vector<LoopClosure> loops = monocular_loops(run);
  const SE3 error(so3_exp(Vec3(0.3, -0.4, 0.2)), Vec3(0.8, -0.6, 0.4));
  for (int k = 100; k < 120; k += 4) {
    LoopClosure loop = run.loop(k, k - 80, Vec6::Zero(), kSigma_m, kSigma_rad, 20);
    loop.T_match_query = run.truth(k - 80).inverse() * run.truth(25) * error * run.truth(25).inverse() * run.truth(k);
    loop = run.in_units(loop);
    loop.scale_covariance(6) = kScaleSigma * kScaleSigma;
    loops.push_back(loop);
  }
  const FinishedRun finished = finish(run, loops, free_scale());
  for (const LoopVerdict& verdict : finished.end.loops) {
    const bool is_right = verdict.query_keyframe_id - verdict.match_keyframe_id == run.round();
    EXPECT_TRUE(is_right || !verdict.kept) << verdict.query_keyframe_id << " " << verdict.match_keyframe_id;
  }
  EXPECT_LT(run.worst_error_m(finished.graph.keyframes()), 0.25);
}

/// What moves on map -> odom is right for the newest frame, before and after corrections.
TEST(FreeScale, MapFromOdometryPlacesEveryNewFrame) {
  const SyntheticRun run = monocular_run();
  const std::vector<LoopClosure> loops = monocular_loops(run);
  PoseGraph graph(free_scale());
  bool has_changed = false;
  for (int k = 0; k < run.size(); ++k) {
    const MapCorrection correction = graph.process(run.frame(k), loops_at(k, loops));
    has_changed = has_changed || correction.changed;
    const SE3 placed = correction.T_map_odom * run.odometry(k);
    EXPECT_LT((placed.t - graph.keyframes().back().T_map_camera.t).norm(), 1e-9) << k;
    EXPECT_EQ(correction.scale, graph.keyframes().back().scale);
  }
  EXPECT_TRUE(has_changed);
}

TEST(FreeScale, ALaterSessionBeginsWhereItIsSaidToStand) {
  const SyntheticRun run = monocular_run();
  PoseGraph first(free_scale());
  for (int k = 0; k < 20; ++k) first.process(run.frame(k), {});
  PoseGraph second(free_scale());
  const Vec3 begin_at(30.0, 0.0, 0.0);
  second.restore(first.state(), begin_at);
  const SE3 T_map_odom(Quaternion::Identity(), begin_at - run.odometry(20).t);
  for (int k = 20; k < 25; ++k) {
    const MapCorrection correction = second.process(run.frame(k), {});
    EXPECT_LT((correction.T_map_odom.t - T_map_odom.t).norm(), 1e-9) << k;
    EXPECT_LT((second.keyframes().back().T_map_camera.t - (T_map_odom * run.odometry(k)).t).norm(), 1e-9) << k;
  }
}

TEST(FreeScale, ALoopTheOtherWayRoundSaysTheSame) {
  const SyntheticRun run = monocular_run();
  Random random(17);
  LoopClosure closure = run.in_units(run.loop(150, 40, Vec6::Zero(), 0.03, 0.02));
  closure.scale_covariance << 2e-4, -1e-4, 1e-4, 5e-5, 0.0, -5e-5, 4e-4;
  const auto forward = make_graph_loop(closure, 1, 0);
  const auto backward = make_graph_loop(closure, 0, 1);  // the query's vertex is the earlier one
  ASSERT_TRUE(forward && backward) << forward.message() << backward.message();
  EXPECT_EQ(backward->from, 0);
  EXPECT_NEAR(forward->scale * backward->scale, 1.0, 1e-12);
  const Sim3 S_world_match = random_similarity(&random, 1.0, 1.0);
  const Sim3 S_world_query = S_world_match * forward->S_from_to();
  for (int i = 0; i < 20; ++i) {
    Vec7 d;
    d << random_tangent(&random, 1e-4, 1e-4), 1e-4 * random.normal();
    const Sim3 S = moved(S_world_query, d);
    const auto chi2 = [&](const GraphLoop& loop, const Sim3& from, const Sim3& to) {
      return chi_squared(loop, {from.T, to.T}, {std::log(from.scale), std::log(to.scale)});
    };
    const double expected = chi2(*forward, S_world_match, S);
    EXPECT_NEAR(chi2(*backward, S, S_world_match), expected, 0.02 * expected);
  }
}

TEST(FreeScale, WhatTheOdometryMissedIsInTheMapsUnitToo) {
  Trajectory trajectory;
  trajectory.T_map_vertex = {SE3(), SE3(Quaternion::Identity(), Vec3(1.0, 0.0, 0.0))};
  trajectory.edges.emplace_back();
  trajectory.edges[0].missed.frozen_s = 1.0;
  trajectory.edges[0].missed.covariance = Mat6::Identity();
  EdgeCovariance joined;
  joined.translation.topLeftCorner<3, 3>().setIdentity();
  joined.rotation.setIdentity();
  trajectory.edges[0].joined = std::make_shared<const EdgeCovariance>(joined);
  const OdometryEdge edge = in_map_unit(trajectory, {std::log(0.5), std::log(0.5)}).edges[0];
  EXPECT_NEAR(edge.joined->translation(0, 0), 0.5, 1e-12) << "m of way";
  EXPECT_NEAR(edge.joined->rotation(0, 0), 0.25, 1e-12) << "m^2 a rad";
  EXPECT_NEAR(edge.joined->rotation(3, 3), 1.0, 1e-12);
  const Mat6& missed = edge.missed.covariance;
  EXPECT_NEAR(missed(0, 0), 0.25, 1e-12) << "m^2";
  EXPECT_NEAR(missed(3, 3), 1.0, 1e-12) << "rad^2";
}

TEST(FreeScale, AMapGoneOnWithAtAFixedScaleKeepsItsKeyframesScales) {
  const SyntheticRun run = monocular_run();
  const std::vector<LoopClosure> loops = monocular_loops(run);
  PoseGraph first(free_scale());
  for (int k = 0; k < run.size(); ++k) first.process(run.frame(k), loops_at(k, loops));
  first.process(run.end_frame(), {});
  const std::vector<KeyframePose> before = first.keyframes();
  ASSERT_NE(before.back().scale, 1.0);
  PoseGraph second{PoseGraphOptions()};
  second.restore(first.state());
  Frame frame = run.frame(run.size() - 1);
  constexpr int kMany = 2500;  // so many that the graph becomes coarser
  for (int k = 0; k < kMany; ++k) {
    ++frame.frame_id;
    ++frame.keyframe_id;
    frame.stamp_ns += 1'000'000'000;
    second.process(frame, {});
  }
  const std::vector<KeyframePose> after = second.keyframes();
  EXPECT_EQ(after.back().scale, 1.0);
  for (std::size_t k = 0; k < before.size(); ++k) {
    EXPECT_NEAR(after[k].scale, before[k].scale, 0.05) << k << ", that of the vertex that carries it";
  }
}

TEST(FreeScale, LoopsWithAnImpossibleScaleAreRefusedByName) {
  const SyntheticRun run = monocular_run();
  const LoopClosure good = monocular_loops(run)[3];
  for (const double scale : {0.0, -1.0, std::numeric_limits<double>::quiet_NaN()}) {
    LoopClosure bad = good;
    bad.scale = scale;
    const std::string error = make_graph_loop(bad, 5, 2).message();
    EXPECT_NE(error.find(std::to_string(good.query_keyframe_id)), std::string::npos) << error;
    EXPECT_NE(error.find("its scale is not positive"), std::string::npos) << error;
  }
  for (const Vec7& covariance : {Vec7(Vec7::Constant(std::numeric_limits<double>::quiet_NaN())),
                                 Vec7(Vec7::Constant(0.1)), Vec7(-Vec7::Unit(6))}) {
    LoopClosure bad = good;
    bad.scale_covariance = covariance;
    const std::string error = make_graph_loop(bad, 5, 2).message();
    EXPECT_NE(error.find("the covariance of its scale"), std::string::npos) << error;
  }
}

TEST(FreeScale, OptionsAreChecked) {
  PoseGraphOptions options;
  options.scale = "loose";
  EXPECT_EQ(validate(options).message(), "parameter 'pose_graph.scale' = 'loose' must be fixed or free");
  options = free_scale();
  options.scale_walk = 0.6;
  EXPECT_EQ(validate(options).message(), "parameter 'pose_graph.scale_walk' = '0.6' must be in (0, 0.5]");
}

}  // namespace
}  // namespace semantic_topo_loop::core
