#include "loop/submap/window_solver.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <random>
#include <vector>

#include "loop/submap/submap_builder.h"
#include "odometry/odometry_delay.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "support/synthetic_desk.h"

namespace semantic_topo_loop::core {
namespace {

using testing::desk_camera;
using testing::desk_classes;
using testing::random_desk;

/// Errors of an odometry: a velocity and a turn rate that come and go within two seconds, 1 sigma.
struct Drift {
  double velocity_mps = 0.0, turn_radps = 0.0;
};

struct Errors {
  double before_m = 0.0, before_rad = 0.0, after_m = 0.0, after_rad = 0.0;  ///< rms at the ends, seen from the middle
  WindowNoise noise;
  double delay_s = 0.0;  ///< found
};

/// A camera goes around a desk; windows of 6 s are solved every half second. The last half of them counts.
/// @param rate_hz of its frames, of the same drift; a whole part of 60   @param delay_s of the odometry's poses
Errors go_round(const Drift& drift, std::uint64_t seed, double rate_hz = 10.0, double delay_s = 0.0,
                const std::vector<testing::Visit>& way = {{0.0, 40.0, 0.0, 200.0}}) {
  constexpr double kDuration_s = 40.0, kSolveInterval_s = 0.5, kMemory_s = 2.0;
  const auto desk = random_desk(seed, 12);
  ObservationWindow window(6.0, 0.0, *desk_classes());
  FrameBuilder builder(KeyframeOptions(), desk_camera());
  std::mt19937_64 random(seed), random_drift(seed);
  WindowSolver solver;
  Errors errors;
  std::vector<SE3> truth;
  SE3 T_odom_camera, last;
  Vec6 rate = Vec6::Zero();
  constexpr double kStep_s = 1.0 / 60.0;
  const int steps = static_cast<int>(std::lround(1.0 / (rate_hz * kStep_s)));
  const double dt = steps * kStep_s, kept = std::exp(-kStep_s / kMemory_s);
  int judged = 0;
  double next_s = 6.0;
  for (int k = 0; k * dt < kDuration_s; ++k) {
    const double time_s = k * dt;
    const SE3 pose = testing::desk_pose(way, time_s);
    const SE3 odometry = testing::desk_pose(way, std::max(time_s - delay_s, 0.0));
    Vec6 drifted = Vec6::Zero();
    for (int j = 0; j < steps && k > 0; ++j) {
      for (int i = 0; i < 6; ++i) {
        const double sigma = i < 3 ? drift.velocity_mps : drift.turn_radps;
        rate(i) = kept * rate(i) + std::sqrt(1.0 - kept * kept) * sigma * testing::noise(random_drift);
      }
      drifted += kStep_s * rate;
    }
    T_odom_camera = k == 0 ? pose : T_odom_camera * (last.inverse() * odometry) * se3_exp(drifted);
    last = odometry;
    truth.push_back(pose);
    const auto frame = builder.build({std::llround(1e9 * (1.0 + time_s)), T_odom_camera});
    window.push(*frame, testing::observe(desk, *frame, pose, 0, random));
    if (time_s < next_s) continue;
    next_s += kSolveInterval_s;
    const std::deque<ObservedFrame>& raw = window.frames();
    const std::size_t anchor = middle_keyframe(raw).value();
    const std::deque<ObservedFrame> solved = solver.solve(raw, anchor);
    if (solver.delay_s() == 0.0) {
      EXPECT_LT((solved[anchor].T_odom_camera.t - raw[anchor].T_odom_camera.t).norm(), 1e-6);
    }
    if (time_s < 0.5 * kDuration_s) continue;
    for (const std::size_t end : {std::size_t{0}, raw.size() - 1}) {
      const auto pose_of = [&](std::size_t i) { return truth[static_cast<std::size_t>(raw[i].frame_id)]; };
      const SE3 right = pose_of(anchor).inverse() * pose_of(end);
      const auto error = [&](const std::deque<ObservedFrame>& frames) {
        return se3_log(right.inverse() * (frames[anchor].T_odom_camera.inverse() * frames[end].T_odom_camera));
      };
      errors.before_m += error(raw).head<3>().squaredNorm();
      errors.before_rad += error(raw).tail<3>().squaredNorm();
      errors.after_m += error(solved).head<3>().squaredNorm();
      errors.after_rad += error(solved).tail<3>().squaredNorm();
      ++judged;
    }
  }
  for (double* sum : {&errors.before_m, &errors.before_rad, &errors.after_m, &errors.after_rad}) {
    *sum = std::sqrt(*sum / judged);
  }
  errors.noise = solver.noise();
  errors.delay_s = solver.delay_s();
  return errors;
}

TEST(WindowSolver, FindsMostOfWhatTheOdometryIsOff) {
  for (const std::uint64_t seed : {1, 2, 3}) {
    const Errors errors = go_round({0.02, 0.015}, seed);
    EXPECT_GT(errors.before_m, 0.03) << seed;
    EXPECT_LT(errors.after_m, 0.4 * errors.before_m) << seed;
    EXPECT_LT(errors.after_rad, 0.4 * errors.before_rad) << seed;
  }
}

TEST(WindowSolver, LeavesAGoodOdometryAsItIs) {
  for (const std::uint64_t seed : {1, 2, 3}) {
    const Errors errors = go_round({}, seed);
    EXPECT_LT(errors.after_m, 0.003) << seed;
    EXPECT_LT(degrees(errors.after_rad), 0.15) << seed;
  }
}

TEST(WindowSolver, LearnsHowGoodTheOdometryIsAtAnyFrameRate) {
  const WindowNoise good = go_round({}, 4).noise;
  const auto lasting = [](const WindowNoise& noise) { return noise.odometry.drift_mps + noise.odometry.step_m; };
  EXPECT_LT(lasting(good), 0.004);
  const WindowNoise usual = go_round({0.02, 0.015}, 4, 30.0).noise;
  EXPECT_GT(lasting(usual), 3.0 * lasting(good));
  EXPECT_LT(lasting(usual), 0.06);
  for (const double rate_hz : {10.0, 15.0, 60.0}) {
    const WindowNoise noise = go_round({0.02, 0.015}, 4, rate_hz).noise;
    EXPECT_NEAR(lasting(noise), lasting(usual), 0.1 * lasting(usual)) << rate_hz;
    EXPECT_NEAR(noise.odometry.drift_radps, usual.odometry.drift_radps, 0.1 * usual.odometry.drift_radps) << rate_hz;
    EXPECT_NEAR(noise.box_factor, 1.0, 0.5);
  }
}

/// Hands swing.
const std::vector<testing::Visit> kSwings = {
    {0.0, 4.0, 0.0, 50.0},    {4.0, 9.0, 50.0, 0.0},    {9.0, 14.0, 0.0, 60.0},
    {14.0, 19.0, 60.0, 20.0}, {19.0, 24.0, 20.0, 80.0}, {24.0, 27.0, 80.0, 40.0},
    {27.0, 32.0, 40.0, 90.0}, {32.0, 36.0, 90.0, 50.0}, {36.0, 40.0, 50.0, 110.0}};

TEST(WindowSolver, FindsHowLateTheOdometryIsAndTakesItOut) {
  for (const double delay_s : {0.08, 0.03, -0.05}) {
    for (const double rate_hz : {10.0, 30.0}) {
      const Errors errors = go_round({}, 5, rate_hz, delay_s, kSwings);
      EXPECT_NEAR(errors.delay_s, delay_s, 0.008) << rate_hz;
      EXPECT_LT(errors.after_m, 0.3 * errors.before_m) << delay_s << ' ' << rate_hz;
    }
  }
}

TEST(WindowSolver, OdometryThatOnlyDriftsIsNotLate) {
  for (const std::uint64_t seed : {6, 7, 8}) {
    EXPECT_EQ(go_round({}, seed, 10.0, 0.0, kSwings).delay_s, 0.0) << seed;
    EXPECT_EQ(go_round({0.02, 0.015}, seed, 10.0, 0.0, kSwings).delay_s, 0.0) << seed;
  }
}

TEST(OdometryDelay, PosesAreTakenBetweenFramesAndGoOnAtTheEnds) {
  std::deque<ObservedFrame> window(4);
  for (std::size_t i = 0; i < window.size(); ++i) {
    const double time_s = 0.1 * static_cast<double>(i);
    window[i].stamp_ns = std::llround(1e9 * (5.0 + time_s));
    window[i].T_odom_camera = SE3(so3_exp(Vec3(0.0, time_s, 0.0)), Vec3(2.0 * time_s, 0.0, 1.0));
  }
  for (const double delay_s : {0.0, 0.04, 0.17, 0.4, -0.04, -0.17, -0.4}) {
    for (std::size_t i = 0; i < window.size(); ++i) {
      const double time_s = 0.1 * static_cast<double>(i) + delay_s;
      const SE3 pose = pose_at_image(window, i, delay_s);
      EXPECT_LT((pose.t - Vec3(2.0 * time_s, 0.0, 1.0)).norm(), 1e-9) << i << ' ' << delay_s;
      EXPECT_LT(rotation_angle(pose.q, so3_exp(Vec3(0.0, time_s, 0.0))), 1e-9) << i << ' ' << delay_s;
    }
  }
}

TEST(OdometryDelay, IsToldOnceItIsEvident) {
  OdometryDelay delay;
  delay.add(0.05, 1.0 / (0.02 * 0.02), 1.0);  // 2.5 sigma
  EXPECT_EQ(delay.seconds(), 0.0);
  delay.add(std::nan(""), 1e6, 1.0);
  delay.add(0.1, -1.0, 1.0);
  for (int i = 0; i < 3; ++i) delay.add(0.05, 1.0 / (0.02 * 0.02), 1.0);
  EXPECT_NEAR(delay.seconds(), 0.05, 1e-9);
  delay.add(0.0, -1.0, 300.0);
  EXPECT_NEAR(delay.seconds(), 0.05, 1e-9) << "a robot that parks";
  for (int i = 0; i < 9; ++i) delay.add(-0.03, 1e5, 3600.0);  // a clock was set
  EXPECT_NEAR(delay.seconds(), -0.03, 1e-3);
  for (int i = 0; i < 9; ++i) delay.add(-0.012, 1e5, 3600.0);
  EXPECT_NEAR(delay.seconds(), -0.012, 1e-3) << "as evident as before";
  for (int i = 0; i < 9; ++i) delay.add(0.005, 1e5, 3600.0);  // less than images are apart
  EXPECT_EQ(delay.seconds(), 0.0);
  for (int i = 0; i < 9; ++i) delay.add(1.0, 1e5, 3600.0);
  EXPECT_EQ(describe_delay(delay.seconds()).rfind("the odometry's poses come 250 ms or more late", 0), 0u);
  EXPECT_EQ(describe_delay(0.0), "");
  EXPECT_EQ(describe_delay(0.0584).rfind("the odometry's poses come 58 ms late against the images", 0), 0u);
  EXPECT_EQ(describe_delay(-0.02).rfind("the odometry's poses come 20 ms early", 0), 0u);
}

TEST(WindowSolver, WithoutBoxesThereIsNothingToFind) {
  std::deque<ObservedFrame> window(30);
  for (std::size_t i = 0; i < window.size(); ++i) {
    window[i].stamp_ns = static_cast<std::int64_t>(i) * 100'000'000;
    window[i].T_odom_camera.t = Vec3(0.02 * static_cast<double>(i), 0.0, 0.0);
  }
  WindowSolver solver;
  EXPECT_EQ(solver.span_s(0.01), std::nullopt);
  const std::deque<ObservedFrame> solved = solver.solve(window, 12);
  for (std::size_t i = 0; i < window.size(); ++i) {
    EXPECT_LT((solved[i].T_odom_camera.t - window[i].T_odom_camera.t).norm(), 1e-9) << i;
  }
  window.resize(1);
  EXPECT_EQ(solver.solve(window, 0).size(), 1u);
}

}  // namespace
}  // namespace semantic_topo_loop::core
