#include <gtest/gtest.h>

#include "geometry/relative_pose.h"
#include "odometry/noise_estimator.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "support/synthetic_run.h"

namespace semantic_topo_loop::core {
namespace {

struct Case {
  std::vector<SE3> vertices;
  std::vector<OdometryEdge> edges;
  std::vector<GraphLoop> loops;
};

/// @param loop_factor true over stated sigmas of the loops
Case make_case(const SyntheticRun& run, double loop_factor, std::uint64_t seed) {
  Case result;
  OdometryAccumulator accumulator;
  for (int k = 0; k < run.size(); ++k) {
    accumulator.add(run.frame(k));
    result.vertices.push_back(run.odometry(k));
    if (k > 0) result.edges.push_back(accumulator.finish(run.odometry(k - 1), run.odometry(k)));
  }
  Random random(1000 + seed);
  for (int k = run.round() + 4; k < run.size(); k += 2) {
    const Vec6 error = random_tangent(&random, kSigma_m * loop_factor, kSigma_rad * loop_factor);
    std::string why;
    result.loops.push_back(
        *make_graph_loop(run.loop(k, k - run.round(), error, kSigma_m, kSigma_rad, 2), k, k - run.round(), &why));
  }
  return result;
}

/// @param noise of the odometry, as the model has it
Case make_case(const OdometryNoise& noise, double loop_factor, std::uint64_t seed) {
  SyntheticRun run;
  const double step_m = (run.truth(1).t - run.truth(0).t).norm();
  const double step_rad = rotation_angle(run.truth(1).q, run.truth(0).q);
  run.drift(noise.translation_m * std::sqrt(step_m), noise.rotation_rad * std::sqrt(step_rad), seed);
  return make_case(run, loop_factor, seed);
}

NoiseEstimate estimate(const Case& data) {
  const NoisePrior prior{OdometryNoise(), 1000.0, 1.5};
  const InnovationModel model(data.vertices, data.edges, data.loops);
  return estimate_noise(model, prior, {prior.least, 1.0, {}});
}

TEST(NoiseEstimator, FindsTheNoiseThatMadeTheInnovations) {
  const OdometryNoise truth{0.05, 0.03};
  double translation = 0.0, rotation = 0.0;
  constexpr int kRuns = 8;
  for (int seed = 1; seed <= kRuns; ++seed) {
    const NoiseEstimate found = estimate(make_case(truth, 1.0, static_cast<std::uint64_t>(seed)));
    translation += found.odometry.translation_m / kRuns;
    rotation += found.odometry.rotation_rad / kRuns;
  }
  EXPECT_NEAR(translation, truth.translation_m, 0.4 * truth.translation_m);
  EXPECT_NEAR(rotation, truth.rotation_rad, 0.4 * truth.rotation_rad);
}

TEST(NoiseEstimator, SuspectedJumpsCountWhereTheLoopsBearThemOut) {
  const SE3 T_jump(so3_exp(Vec3(0.02, -0.06, 0.03)), Vec3(0.15, -0.2, 0.1));
  constexpr int kJump = 60;
  for (const bool has_jumped : {false, true}) {
    SyntheticRun run;
    run.drift(1e-4, 1e-5, 5);
    const SE3 before = run.odometry(kJump);
    const Vec6 suspect = se3_log(before.inverse() * T_jump * before);
    if (has_jumped) run.restart(kJump, T_jump);
    Case data = make_case(run, 1.0, 5);
    data.edges[kJump - 1].suspect = suspect;
    data.edges[kJump - 1].suspect_error_m = 0.01;
    data.edges[kJump - 1].suspect_error_rad = 0.005;
    NoisePrior prior{OdometryNoise(), 1000.0, 1.5};
    prior.least.suspicion = 0.03;
    const InnovationModel model(data.vertices, data.edges, data.loops);
    const double suspicion = estimate_noise(model, prior, {prior.least, 1.0, {}}).odometry.suspicion;
    if (has_jumped) {
      EXPECT_GT(suspicion, 0.5);
    } else {
      EXPECT_LT(suspicion, 0.1);
    }
  }
}

TEST(NoiseEstimator, LoopNoiseIsNotTakenForOdometryNoise) {
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    const NoiseEstimate found = estimate(make_case({1e-4, 1e-4}, 1.0, seed));
    EXPECT_LT(found.odometry.translation_m, 0.005) << seed;
    EXPECT_LT(found.odometry.rotation_rad, 0.003) << seed;
    EXPECT_NEAR(found.loop_factor, 1.0, 0.2) << seed;
  }
}

TEST(NoiseEstimator, LoopsThatOverstateTheirPrecisionAreFoundOut) {
  const NoiseEstimate found = estimate(make_case({0.01, 0.01}, 2.0, 3));
  EXPECT_NEAR(found.loop_factor, 2.0, 0.4);
}

TEST(NoiseEstimator, StaysInItsBounds) {
  const Case data = make_case({0.5, 0.3}, 1.0, 2);
  const NoisePrior prior{OdometryNoise(), 3.0, 1.5};
  const InnovationModel model(data.vertices, data.edges, data.loops);
  const NoiseEstimate found = estimate_noise(model, prior, {prior.least, 1.0, {}});
  EXPECT_NEAR(found.odometry.translation_m, 3.0 * prior.least.translation_m, 1e-9);
  EXPECT_NEAR(found.odometry.rotation_rad, 3.0 * prior.least.rotation_rad, 1e-9);
}

TEST(NoiseEstimator, RobustFactorIgnoresAMinorityOfFalseLoops) {
  Case data = make_case({0.02, 0.012}, 1.0, 5);
  const NoisePrior prior{OdometryNoise(), 1000.0, 1.5};
  const auto factor = [&] {
    const PathNoise path(data.vertices, data.edges);
    std::vector<double> factors;
    for (const GraphLoop& loop : data.loops) factors.push_back(path.explaining_factor(loop, prior.least, 1000.0));
    return robust_noise_factor(factors, std::vector<double>(factors.size(), 1.0));
  };
  const double clean = factor();
  Random random(6);
  for (std::size_t k = 0; k < data.loops.size(); k += 4) {
    data.loops[k].T_from_to = data.loops[k].T_from_to * random_motion(&random, 2.0, 1.0);
  }
  EXPECT_GT(clean, 1.0);
  EXPECT_LT(factor(), 2.5 * clean);
}

TEST(InnovationModel, DoesNotDependOnWhereItIsLinearised) {
  // At the odometry itself and at poses bent by a part of the correction the same innovations come out.
  const Case data = make_case({0.02, 0.01}, 1.0, 7);
  Case bent = data;
  for (std::size_t i = 0; i < bent.vertices.size(); ++i) {
    Vec6 d = Vec6::Zero();
    d(0) = 2e-4 * static_cast<double>(i);
    d(5) = 5e-5 * static_cast<double>(i);
    bent.vertices[i] = bent.vertices[i] * se3_exp(d);
  }
  const InnovationModel a(data.vertices, data.edges, data.loops), b(bent.vertices, bent.edges, bent.loops);
  const OdometryNoise noise{0.02, 0.01};
  EXPECT_NEAR(a.cost(noise, 1.0), b.cost(noise, 1.0), 0.02 * std::abs(a.cost(noise, 1.0)));
}

TEST(Redundancy, CopiesShareOneVoice) {
  SyntheticRun run;
  std::string why;
  std::vector<GraphLoop> loops;
  for (int i = 0; i < 4; ++i) loops.push_back(*make_graph_loop(run.exact_loop(150, 50), 150, 50, &why));
  loops.push_back(*make_graph_loop(run.exact_loop(180, 80), 180, 80, &why));
  const std::vector<double> sums = redundancy(loops);
  for (std::size_t i = 0; i < 4; ++i) EXPECT_DOUBLE_EQ(sums[i], 4.0);
  EXPECT_DOUBLE_EQ(sums[4], 1.0);
}

TEST(GraphLoop, DirectionDoesNotMatter) {
  SyntheticRun run;
  Random random(3);
  LoopClosure forward = run.loop(150, 50, random_tangent(&random, 0.02, 0.01), 0.02, 0.01);
  LoopClosure backward = forward;
  std::swap(backward.query_keyframe_id, backward.match_keyframe_id);
  backward.T_match_query = forward.T_match_query.inverse();
  backward.covariance = inverse_covariance(forward.T_match_query, forward.covariance);
  std::string why;
  const auto a = make_graph_loop(forward, 150, 50, &why), b = make_graph_loop(backward, 50, 150, &why);
  ASSERT_TRUE(a && b);
  EXPECT_EQ(a->from, b->from);
  EXPECT_LT((a->T_from_to.t - b->T_from_to.t).norm(), 1e-12);
  EXPECT_LT((a->covariance - b->covariance).cwiseAbs().maxCoeff(), 1e-12);
}

TEST(GraphLoop, RefusalNamesTheLoop) {
  SyntheticRun run;
  LoopClosure loop = run.exact_loop(150, 50);
  loop.covariance.setZero();
  std::string why;
  EXPECT_FALSE(make_graph_loop(loop, 150, 50, &why));
  EXPECT_EQ(why, "loop of keyframes 150 and 50 refused: its covariance is not positive definite");
  EXPECT_FALSE(make_graph_loop(run.exact_loop(150, 50), 150, -1, &why));
  EXPECT_EQ(why, "loop of keyframes 150 and 50 refused: its match keyframe is unknown");
}

}  // namespace
}  // namespace semantic_topo_loop::core
