#include <gtest/gtest.h>

#include <cmath>

#include "geometry/relative_pose.h"
#include "odometry/motion_bursts.h"
#include "odometry/noise_estimator.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "support/synthetic_run.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kFrames = 300, kFramesPerSection = 5;
constexpr std::int64_t kIntervalNs = 33'333'333;

Frame frame_at(std::int64_t stamp_ns, const SE3& T_odom_camera, bool is_break = false) {
  Frame frame;
  frame.stamp_ns = stamp_ns;
  frame.T_odom_camera = T_odom_camera;
  frame.is_break = is_break;
  return frame;
}

/// A shaky camera that turns on its way; from frame `first` on the odometry adds `jump` in equal parts over `frames`.
/// @return what it added, in the axes of the odometry
Vec6 feed(MotionBursts* bursts, int first, int frames, const Vec6& jump) {
  Random random(4);
  SE3 pose;
  Vec6 added = Vec6::Zero();
  bursts->push(frame_at(0, pose), 0);
  for (int k = 0; k < kFrames; ++k) {
    Vec6 motion;
    motion << 0.001 * random.normal3(), 0.002 * random.normal3();
    motion(0) += 0.01 * std::sin(0.02 * k);
    motion(5) += 0.02;
    pose = pose * se3_exp(motion);
    if (k >= first && k < first + frames) {
      pose = pose * se3_exp(jump / frames);
      added.head<3>() += pose.q * jump.head<3>() / frames;
      added.tail<3>() += pose.q * jump.tail<3>() / frames;
    }
    bursts->push(frame_at((k + 1) * kIntervalNs, pose), static_cast<std::size_t>(k / kFramesPerSection));
  }
  return added;
}

TEST(MotionBursts, FindsHowFarABurstJumpedAndNothingElse) {
  Vec6 jump;
  jump << 0.05, 0.15, -0.08, 0.03, -0.04, 0.02;
  for (const int frames : {1, 3, 5, 8, 11}) {
    MotionBursts bursts;
    const Vec6 added = feed(&bursts, 148, frames, jump);
    Vec6 sum = Vec6::Zero();
    double error_m = 0.0, error_rad = 0.0;
    for (std::size_t i = 0; i <= kFrames / kFramesPerSection; ++i) {
      const MotionBursts::SuspectedJump found = bursts.suspected_jump(i);
      const bool is_within = i >= 147 / kFramesPerSection && i <= (150 + static_cast<std::size_t>(frames)) / 5;
      if (!is_within) {
        EXPECT_LT(found.motion.norm(), 0.01) << i;  // as much as the hand shakes in two frames
      }
      sum += found.motion;
      error_m += found.error_m;
      error_rad += found.error_rad;
    }
    EXPECT_LT((sum - added).head<3>().norm(), 0.02) << frames;
    EXPECT_LT((sum - added).tail<3>().norm(), 0.03) << frames;
    EXPECT_GT(error_m, 0.0005);
    EXPECT_LT(error_m, 0.02);
    EXPECT_GT(error_rad, 0.0005);
    EXPECT_LT(error_rad, 0.03);
  }
}

/// Two minutes by hand at 120 Hz, with a jump of another length every ten seconds, of which every n-th frame is given.
struct Jumps {
  Vec6 suspected = Vec6::Zero(), added = Vec6::Zero();
  int noticed = 0;
};
Jumps jumps_at(int every) {
  constexpr int kRate_hz = 120, kJumpEvery = 10 * kRate_hz, kSteps = 120 * kRate_hz;
  constexpr double kShake_s = 0.3, kDt_s = 1.0 / kRate_hz;
  const double kept = std::exp(-kDt_s / kShake_s);
  Random random(8);
  MotionBursts bursts;
  BurstWatch watch;
  Jumps jumps;
  SE3 pose;
  Vec6 shake = Vec6::Zero();
  for (int k = 0; k < kSteps; ++k) {
    for (int i = 0; i < 6; ++i) shake(i) = kept * shake(i) + std::sqrt(1.0 - kept * kept) * random.normal();
    Vec6 rate;
    rate << 0.05 * shake.head<3>(), 0.08 * shake.tail<3>();
    rate(0) += 0.3 * std::sin(0.6 * kDt_s * k);
    pose = pose * se3_exp(kDt_s * rate);
    const int since = k % kJumpEvery - kJumpEvery / 2, frames = 1 + k / kJumpEvery * 3;
    if (k > kJumpEvery && since >= 0 && since < frames) {
      Vec6 jump;
      jump << 0.3, 0.2, -0.1, 0.2, 0.0, -0.1;
      pose = pose * se3_exp(jump / frames);
      jumps.added.head<3>() += pose.q * jump.head<3>() / frames;
      jumps.added.tail<3>() += pose.q * jump.tail<3>() / frames;
    }
    if (k % every != 0) continue;
    const Frame frame = frame_at(static_cast<std::int64_t>(1e9 * kDt_s * k), pose);
    bursts.push(frame, 0);
    jumps.noticed += watch.push(frame) ? 1 : 0;
  }
  jumps.suspected = bursts.suspected_jump(0).motion;
  return jumps;
}

TEST(MotionBursts, TellsTheSameAtAnyFrameRate) {
  for (const int rate_hz : {60, 30, 20, 15, 10}) {
    const Jumps jumps = jumps_at(120 / rate_hz);
    EXPECT_LT((jumps.suspected - jumps.added).norm(), 0.1 * jumps.added.norm())
        << rate_hz << " Hz: " << jumps.suspected.transpose() << " of " << jumps.added.transpose();
    EXPECT_EQ(jumps.noticed, 11) << rate_hz;
  }
}

TEST(MotionBursts, AShakyHandIsNoBurst) {
  MotionBursts bursts;
  feed(&bursts, 0, 0, Vec6::Zero());
  for (std::size_t i = 0; i <= kFrames / kFramesPerSection; ++i) {
    EXPECT_LT(bursts.suspected_jump(i).motion.head<3>().norm(), 0.003) << i;
    EXPECT_LT(bursts.suspected_jump(i).motion.tail<3>().norm(), 0.01) << i;
  }
}

TEST(MotionBursts, ABreakIsNoBurstAndAPoseThatIsNotLaterNoMotion) {
  constexpr int kBreak = 150;
  Random random(4);
  MotionBursts bursts;
  SE3 pose;
  for (int k = 0; k < kFrames; ++k) {
    Vec6 motion;
    motion << 0.001 * random.normal3(), 0.002 * random.normal3();
    pose = pose * se3_exp(motion);
    if (k == kBreak) pose.t.x() += 5.0;
    bursts.push(frame_at(k * kIntervalNs, pose, k == kBreak), 0);
    pose.t.y() += 1.0;
    bursts.push(frame_at(k * kIntervalNs, pose), 0);
  }
  EXPECT_LT(bursts.suspected_jump(0).motion.head<3>().norm(), 0.005);
}

/// A camera that moves on otherwise after images were lost has not jumped.
TEST(MotionBursts, AGapIsNoBurst) {
  constexpr int kGapEvery = 150, kGapFrames = 20;
  MotionBursts bursts;
  Random random(4);
  SE3 pose;
  double speed_m = 0.0;
  for (int k = 0; k < kFrames; ++k) {
    if (k % kGapEvery == 0) speed_m = 0.02 * random.normal();
    Vec6 motion;
    motion << 0.001 * random.normal3(), 0.002 * random.normal3();
    motion(0) += speed_m;
    pose = pose * se3_exp(motion);
    if (k % kGapEvery >= kGapFrames) bursts.push(frame_at(k * kIntervalNs, pose), 0);
  }
  EXPECT_EQ(bursts.suspected_jump(0).motion.norm(), 0.0);
}

/// Nor has one that was fast when it was lost, and is slow when found again.
TEST(MotionBursts, AGapThatEndsInABreakIsNoBurstEither) {
  MotionBursts bursts;
  Random random(4);
  SE3 pose;
  for (int k = 0; k < 300; ++k) {
    const bool is_lost = k >= 126 && k < 186;
    Vec6 motion;
    motion << 0.001 * random.normal3(), 0.002 * random.normal3();
    if (k >= 120 && k < 126) motion(0) += 0.1;
    pose = pose * se3_exp(motion);
    if (!is_lost) bursts.push(frame_at(k * kIntervalNs, pose, k == 186), 0);
  }
  EXPECT_LT(bursts.suspected_jump(0).motion.norm(), 0.01);
}

TEST(MotionBursts, AWayThatWasMissedIsNoBurst) {
  constexpr int kLostEvery = 150, kLostFrames = 20;
  MotionBursts bursts;
  Random random(4);
  SE3 pose, given;
  for (int k = 0; k < kFrames; ++k) {
    Vec6 motion;
    motion << 0.001 * random.normal3(), 0.002 * random.normal3();
    motion(0) += 0.01;
    pose = pose * se3_exp(motion);
    if (k % kLostEvery >= kLostFrames) given = pose;
    Frame frame = frame_at(k * kIntervalNs, given);
    if (k % kLostEvery == kLostFrames) frame.held_since_ns = (k - kLostFrames) * kIntervalNs;
    bursts.push(frame, 0);
  }
  EXPECT_LT(bursts.suspected_jump(0).motion.norm(), 0.03);
}

TEST(OdometryAccumulator, CovariancesAddUpBetweenKeyframes) {
  SyntheticRun run;
  OdometryAccumulator accumulator;
  Random random(10);
  Mat6 sampled = Mat6::Zero();
  constexpr double kStep_m = 0.002, kStep_rad = 0.004;
  Vec6 variances;
  variances << Vec3::Constant(kStep_m * kStep_m), Vec3::Constant(kStep_rad * kStep_rad);
  for (int k = 0; k <= 20; ++k) {
    Frame frame = run.frame(k);
    frame.covariance = variances.asDiagonal();
    accumulator.add(frame);
  }
  const OdometryEdge edge = accumulator.finish(run.odometry(0), run.odometry(20));
  ASSERT_TRUE(edge.covariance);
  constexpr int kSamples = 4000;
  for (int i = 0; i < kSamples; ++i) {
    SE3 T;
    for (int k = 1; k <= 20; ++k) {
      T = T * (run.truth(k - 1).inverse() * run.truth(k) * random_motion(&random, kStep_m, kStep_rad));
    }
    const Vec6 e = se3_log(edge.T_from_to.inverse() * T);
    sampled += e * e.transpose() / kSamples;
  }
  EXPECT_LT((sampled - *edge.covariance).cwiseAbs().maxCoeff(), 0.1 * edge.covariance->cwiseAbs().maxCoeff());
}

/// Path and sum of rotations of ten seconds at 0.2 m/s and 0.3 rad/s, or standing, with jitter of each pose.
OdometryEdge jittering_edge(double rate_hz, bool stands) {
  OdometryAccumulator accumulator;
  Random random(11);
  constexpr double kDuration_s = 10.0, kJitter_m = 0.0005, kJitter_rad = 0.0002;
  const auto pose = [&](double time_s) {
    const double moves_for_s = stands ? 0.0 : time_s;
    const SE3 T(so3_exp(Vec3(0.0, 0.3 * moves_for_s, 0.0)), Vec3(0.2 * moves_for_s, 0.0, 0.0));
    return T * random_motion(&random, kJitter_m, kJitter_rad);
  };
  Frame frame;
  for (int i = 0; i <= static_cast<int>(kDuration_s * rate_hz); ++i) {
    frame.T_odom_camera = pose(i / rate_hz);
    accumulator.add(frame);
  }
  return accumulator.finish(SE3(), frame.T_odom_camera);
}

TEST(OdometryAccumulator, HasTheSameWayAtAnyRateAndNoneOfACameraThatStands) {
  for (const double rate_hz : {5.0, 10.0, 30.0, 60.0}) {
    const OdometryEdge moving = jittering_edge(rate_hz, false), standing = jittering_edge(rate_hz, true);
    EXPECT_NEAR(moving.path_m, 2.0, 0.05) << rate_hz << " Hz";
    EXPECT_NEAR(moving.rotation_rad, 3.0, 0.05) << rate_hz << " Hz";
    EXPECT_EQ(standing.path_m, 0.0) << rate_hz << " Hz";
    EXPECT_EQ(standing.rotation_rad, 0.0) << rate_hz << " Hz";
  }
}

TEST(OdometryAccumulator, AFrameWithoutCovarianceMakesTheEdgeUseTheModel) {
  SyntheticRun run;
  OdometryAccumulator accumulator;
  for (int k = 0; k <= 3; ++k) {
    Frame frame = run.frame(k);
    if (k != 2) frame.covariance = Mat6::Identity();
    accumulator.add(frame);
  }
  EXPECT_FALSE(accumulator.finish(run.odometry(0), run.odometry(3)).covariance);
}

struct Case {
  std::vector<SE3> vertices;
  std::vector<OdometryEdge> edges;
  std::vector<GraphLoop> loops;
};

/// @param loop_factor true over stated sigmas of the loops
Case make_case(const SyntheticRun& run, double loop_factor, std::uint64_t seed) {
  Case result{run.odometry(), run.edges(), {}};
  Random random(1000 + seed);
  for (int k = run.round() + 4; k < run.size(); k += 2) {
    const Vec6 error = random_tangent(&random, kSigma_m * loop_factor, kSigma_rad * loop_factor);
    result.loops.push_back(graph_loop(run.loop(k, k - run.round(), error, kSigma_m, kSigma_rad, 2)));
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

/// Puts a case behind another, whose last edge leads to it.
void append(const Case& later, Case* all) {
  const int first = static_cast<int>(all->vertices.size());
  all->vertices.insert(all->vertices.end(), later.vertices.begin(), later.vertices.end());
  all->edges.insert(all->edges.end(), later.edges.begin(), later.edges.end());
  for (GraphLoop loop : later.loops) {
    loop.from += first;
    loop.to += first;
    all->loops.push_back(loop);
  }
}

NoiseEstimate estimate(const Case& data, const NoisePrior& prior = {}) {
  InnovationModel model(data.vertices, data.edges, data.loops);
  return estimate_noise_and_jumps(&model, prior, {prior.least, 1.0, {}}, 0).noise;
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
    const Vec6 jump = se3_log(before.inverse() * T_jump * before);
    if (has_jumped) run.restart(kJump, T_jump);
    Case data = make_case(run, 1.0, 5);
    data.edges[kJump - 1].suspected_jump = jump;
    data.edges[kJump - 1].jump_error_m = 0.01;
    data.edges[kJump - 1].jump_error_rad = 0.005;
    NoisePrior prior;
    prior.least.jump_prior = 0.03;
    const double jump_prior = estimate(data, prior).odometry.jump_prior;
    if (has_jumped) {
      EXPECT_GT(jump_prior, 0.5);
    } else {
      EXPECT_LT(jump_prior, 0.1);
    }
  }
}

TEST(NoiseEstimator, LoopNoiseIsNotTakenForOdometryNoise) {
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    const NoiseEstimate found = estimate(make_case(OdometryNoise{1e-4, 1e-4}, 1.0, seed));
    EXPECT_LT(found.odometry.translation_m, 0.005) << seed;
    EXPECT_LT(found.odometry.rotation_rad, 0.003) << seed;
    EXPECT_NEAR(found.loop_factor, 1.0, 0.2) << seed;
  }
}

TEST(NoiseEstimator, LoopsThatOverstateTheirPrecisionAreFoundOut) {
  const NoiseEstimate found = estimate(make_case(OdometryNoise{0.01, 0.01}, 2.0, 3));
  EXPECT_NEAR(found.loop_factor, 2.0, 0.4);
}

TEST(NoiseEstimator, EdgesOfAMapThatIsGoneOnWithSayNothingOfTheNoise) {
  constexpr int kBefore = 600;
  SyntheticRun run;
  Vec6 bias = Vec6::Zero();
  bias << 0.004, 0.002, 0.0, 0.0, 0.0, 0.0006;
  run.drift(1e-4, 1e-4, 3, bias, 60);  // in a part of the run
  const Case session = make_case(run, 1.0, 3);
  OdometryEdge settled;
  settled.T_from_to.t = Vec3(0.0, 0.0, 0.3);
  settled.path_m = 0.3;
  settled.covariance = Mat6(1e-8 * Mat6::Identity());
  Case both{{session.vertices.front() * SE3(Quaternion::Identity(), Vec3(0.0, 0.0, -0.3 * kBefore))},
            std::vector<OdometryEdge>(kBefore, settled),
            {}};
  for (int k = 1; k < kBefore; ++k) both.vertices.push_back(both.vertices.back() * settled.T_from_to);
  append(session, &both);
  NoisePrior prior;
  prior.least.steady_translation = 0.0003;
  prior.least.steady_rotation_rad = 0.0001;
  const OdometryNoise alone = estimate(session, prior).odometry, behind = estimate(both, prior).odometry;
  constexpr double kRounding = 0.01;
  EXPECT_GT(alone.steady_translation, 10.0 * prior.least.steady_translation) << "the drift shows";
  EXPECT_NEAR(behind.translation_m, alone.translation_m, kRounding * alone.translation_m);
  EXPECT_NEAR(behind.steady_translation, alone.steady_translation, kRounding * alone.steady_translation);
  EXPECT_NEAR(behind.steady_rotation_rad, alone.steady_rotation_rad, kRounding * alone.steady_rotation_rad);
}

TEST(NoiseEstimator, EachOdometryHasErrorsOfItsOwnThatLast) {
  // Two robots, of whom one's odometry turns to one side, the other's as much to the other.
  const Vec3 bias(0.0, 0.0, 0.002);
  Case both;
  std::vector<int> odometry_begins;
  for (const double sign : {1.0, -1.0}) {
    SyntheticRun run;
    Vec6 turn = Vec6::Zero();
    turn.tail<3>() = sign * bias;
    run.drift(1e-4, 1e-5, 3, turn);
    if (sign < 0.0) both.edges.emplace_back().is_break = true;
    odometry_begins.push_back(static_cast<int>(both.vertices.size()));
    append(make_case(run, 1.0, 3), &both);
  }
  NoisePrior prior;
  prior.least.steady_translation = 0.0003;
  prior.least.steady_rotation_rad = 0.0001;
  InnovationModel model(both.vertices, both.edges, both.loops, odometry_begins);
  const NoiseEstimate noise = estimate_noise_and_jumps(&model, prior, {prior.least, 1.0, {}}, 0).noise;
  const std::vector<Vec6> errors = model.steady_errors(noise);
  const int size = odometry_begins.back();
  for (const int first : odometry_begins) {
    Vec3 mean = Vec3::Zero();
    for (int i = first; i + 1 < first + size; ++i) mean += errors[static_cast<std::size_t>(i)].tail<3>();
    mean /= size - 1;
    EXPECT_LT((mean - (first == 0 ? -bias : bias)).norm(), 0.2 * bias.norm()) << mean.transpose();
  }
  EXPECT_LT(noise.odometry.translation_m, 0.01);
}

TEST(NoiseEstimator, StaysInItsBounds) {
  NoisePrior prior;
  prior.factor_max = 3.0;
  const NoiseEstimate found = estimate(make_case(OdometryNoise{0.5, 0.3}, 1.0, 2), prior);
  EXPECT_NEAR(found.odometry.translation_m, 3.0 * prior.least.translation_m, 1e-9);
  EXPECT_NEAR(found.odometry.rotation_rad, 3.0 * prior.least.rotation_rad, 1e-9);
}

TEST(NoiseEstimator, RobustFactorIgnoresAMinorityOfFalseLoops) {
  Case data = make_case(OdometryNoise{0.02, 0.012}, 1.0, 5);
  const auto factor = [&] {
    const PathNoise path(data.vertices, data.edges);
    std::vector<double> factors;
    for (const GraphLoop& loop : data.loops) factors.push_back(path.explaining_factor(loop, OdometryNoise(), 1000.0));
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

TEST(InnovationModel, DoesNotDependOnHowFarAwayTheWorldIs) {
  // Next to nothing is known of a break, which a thousand kilometres from the origin drowns what else is.
  Case data = make_case(OdometryNoise{0.02, 0.01}, 1.0, 7);
  data.edges[data.edges.size() / 2].is_break = true;
  Case far = data;
  for (SE3& T_world_vertex : far.vertices) T_world_vertex.t += Vec3(4e5, -1e6, 2e5);
  const OdometryNoise noise{0.02, 0.01};
  const InnovationModel a(data.vertices, data.edges, data.loops), b(far.vertices, far.edges, far.loops);
  EXPECT_NEAR(b.cost(noise, 1.0), a.cost(noise, 1.0), 1e-3 * std::abs(a.cost(noise, 1.0)));
  const PathNoise near_path(data.vertices, data.edges), far_path(far.vertices, far.edges);
  for (const GraphLoop& loop : data.loops) {
    const double factor = near_path.explaining_factor(loop, OdometryNoise(), 1000.0);
    EXPECT_NEAR(far_path.explaining_factor(loop, OdometryNoise(), 1000.0), factor, 1e-3 * factor);
  }
}

TEST(InnovationModel, APoseFarAwayBetweenTwoBreaksSpoilsNothing) {
  Case data = make_case(OdometryNoise{0.02, 0.01}, 1.0, 7);
  const std::size_t middle = data.edges.size() / 2;
  data.edges[middle].is_break = data.edges[middle + 1].is_break = true;
  Case far = data;
  far.vertices[middle + 1].t.x() += 1e6;
  const PathNoise near_path(data.vertices, data.edges), far_path(far.vertices, far.edges);
  for (const GraphLoop& loop : data.loops) {
    if (loop.from <= static_cast<int>(middle) + 1) continue;
    const double factor = near_path.explaining_factor(loop, OdometryNoise(), 1000.0);
    EXPECT_NEAR(far_path.explaining_factor(loop, OdometryNoise(), 1000.0), factor, 1e-3 * factor);
  }
}

TEST(InnovationModel, DoesNotDependOnWhereItIsLinearised) {
  // At the odometry itself and at poses bent by a part of the correction the same innovations come out.
  const Case data = make_case(OdometryNoise{0.02, 0.01}, 1.0, 7);
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
  std::vector<GraphLoop> loops(4, graph_loop(run.exact_loop(150, 50)));
  loops.push_back(graph_loop(run.exact_loop(180, 80)));
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
  const auto a = make_graph_loop(forward, 150, 50), b = make_graph_loop(backward, 50, 150);
  ASSERT_TRUE(a && b);
  EXPECT_EQ(a->from, b->from);
  EXPECT_LT((a->T_from_to.t - b->T_from_to.t).norm(), 1e-12);
  EXPECT_LT((a->covariance - b->covariance).cwiseAbs().maxCoeff(), 1e-12);
}

TEST(GraphLoop, RefusalNamesTheLoop) {
  SyntheticRun run;
  LoopClosure loop = run.exact_loop(150, 50);
  loop.covariance.setZero();
  EXPECT_EQ(make_graph_loop(loop, 150, 50).message(),
            "loop of keyframes 150 and 50 refused: its covariance is not positive definite");
  EXPECT_EQ(make_graph_loop(run.exact_loop(150, 50), 150, -1).message(),
            "loop of keyframes 150 and 50 refused: its match keyframe is unknown");
}

}  // namespace
}  // namespace semantic_topo_loop::core
