#include "tools/evaluation/trajectory_evaluation.h"

#include <gtest/gtest.h>

#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "support/random_poses.h"
#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::int64_t kMs = 1000000;

/// A curved path sampled at 30 Hz.
StampedPoses make_path(int n) {
  StampedPoses poses;
  for (int i = 0; i < n; ++i) {
    const double s = 0.03 * i;
    poses.push_back({1000000000000 + i * 33 * kMs, SE3(so3_exp(Vec3(0.1 * s, 0.2, 0.3 * s)),
                                                       Vec3(std::cos(s), std::sin(s), 0.2 * std::sin(2.0 * s)))});
  }
  return poses;
}

TEST(ErrorStatistics, OfKnownErrors) {
  const ErrorStatistics e = error_statistics({3.0, 1.0, 2.0, 4.0});
  EXPECT_EQ(e.count, 4u);
  EXPECT_EQ(e.mean, 2.5);
  EXPECT_EQ(e.median, 2.5);
  EXPECT_EQ(e.max, 4.0);
  EXPECT_NEAR(e.rmse, std::sqrt(7.5), 1e-15);
  EXPECT_EQ(error_statistics({5.0, 1.0, 2.0}).median, 2.0);
  EXPECT_EQ(error_statistics({}).count, 0u);
}

TEST(TrajectoryEvaluation, AssociatesTheNearestStampWithinTheLimit) {
  StampedPoses estimate = make_path(50), reference = estimate;
  for (std::size_t i = 0; i < 50; ++i) {
    reference[i].stamp_ns = 30 * kMs * static_cast<std::int64_t>(i);
    estimate[i].stamp_ns = reference[i].stamp_ns + (i % 2 == 0 ? 14 : -14) * kMs;  // 16 ms from another one
  }
  estimate.back().stamp_ns = reference.back().stamp_ns + 20 * kMs;  // too far by a nanosecond
  auto e = evaluate_trajectory(estimate, reference);
  ASSERT_TRUE(e) << e.message();
  EXPECT_EQ(e->pairs, 49u);
  EXPECT_NEAR(e->absolute_m.max, 0.0, 1e-9);
  estimate.back().stamp_ns -= 1;
  e = evaluate_trajectory(estimate, reference);
  ASSERT_TRUE(e) << e.message();
  EXPECT_EQ(e->pairs, 50u);
}

TEST(TrajectoryEvaluation, ARigidlyMovedTrajectoryHasNoError) {
  RandomPoses random(41);
  const StampedPoses reference = make_path(200);
  const SE3 T = random.pose(5.0);
  StampedPoses estimate = reference;
  for (StampedPose& pose : estimate) pose.T_world_camera = T * pose.T_world_camera;
  const auto e = evaluate_trajectory(estimate, reference);
  ASSERT_TRUE(e);
  EXPECT_EQ(e->pairs, 200u);
  EXPECT_NEAR(e->absolute_m.max, 0.0, 1e-9);
  EXPECT_NEAR(e->relative_m.max, 0.0, 1e-9);
  EXPECT_NEAR(e->relative_deg.max, 0.0, 1e-6);
  EXPECT_NEAR((e->alignment.T_a_b.matrix() - T.inverse().matrix()).norm(), 0.0, 1e-9);
}

TEST(TrajectoryEvaluation, WithAKnownAlignmentWhatIsOffAsAWholeIsAnError) {
  RandomPoses random(41);
  const StampedPoses reference = make_path(200);
  const SE3 T_reference_map = random.pose(5.0), off(so3_exp(Vec3(0.0, radians(3.0), 0.0)), Vec3::Zero());
  StampedPoses session = reference;
  for (StampedPose& pose : session) {
    pose.T_world_camera = T_reference_map.inverse() * pose.T_world_camera * off;
    pose.T_world_camera.t += Vec3(0.0, 0.1, 0.0);
  }
  const Alignment known{T_reference_map, 1.0};
  const auto e = evaluate_trajectory(session, reference, false, known);
  ASSERT_TRUE(e);
  EXPECT_NEAR(e->absolute_m.median, 0.1, 1e-9);
  EXPECT_NEAR(e->absolute_deg.median, 3.0, 1e-6);
  EXPECT_NEAR(evaluate_trajectory(session, reference)->absolute_m.max, 0.0, 1e-9);
  const StampedPoses one(session.begin(), session.begin() + 1);
  EXPECT_TRUE(evaluate_trajectory(one, reference, false, known)) << "one pose is enough";
  EXPECT_FALSE(evaluate_trajectory({}, reference, false, known));
}

TEST(TrajectoryEvaluation, ScaleIsAnErrorUnlessAligned) {
  const StampedPoses reference = make_path(200);
  StampedPoses estimate = reference;
  for (StampedPose& pose : estimate) pose.T_world_camera.t *= 0.5;
  EXPECT_GT(evaluate_trajectory(estimate, reference)->absolute_m.rmse, 0.1);
  const auto e = evaluate_trajectory(estimate, reference, true);
  EXPECT_NEAR(e->alignment.scale, 2.0, 1e-9);
  EXPECT_NEAR(e->absolute_m.max, 0.0, 1e-9);
  EXPECT_NEAR(e->relative_m.max, 0.0, 1e-9);
}

TEST(TrajectoryEvaluation, RelativeErrorOfASteadyDrift) {
  // The estimate yaws 2 deg/s too much and creeps 1 cm/s along its own z axis.
  StampedPoses reference, estimate;
  SE3 T_true, T_estimated;
  for (int i = 0; i < 100; ++i) {
    reference.push_back({i * 50 * kMs, T_true});
    estimate.push_back({i * 50 * kMs, T_estimated});
    const SE3 step(so3_exp(Vec3(0.01, 0.03, 0.0)), Vec3(0.02, 0.0, 0.01));
    T_true = T_true * step;
    T_estimated = T_estimated * step * SE3(so3_exp(Vec3(0.0, radians(0.1), 0.0)), Vec3(0.0, 0.0, 0.0005));
  }
  const auto e = evaluate_trajectory(estimate, reference);
  ASSERT_TRUE(e);
  EXPECT_EQ(e->relative_deg.count, 80u);
  EXPECT_NEAR(e->relative_deg.mean, 2.0, 0.1);
  EXPECT_NEAR(e->relative_m.mean, 0.01, 0.01);
}

TEST(TrajectoryEvaluation, APoseHasOnePartner) {
  // 200 Hz against 30 Hz of the same path: shared partners would be up to 16 ms of motion off.
  StampedPoses fast, slow;
  const auto pose_at = [](double s) { return SE3(Quaternion::Identity(), Vec3(0.5 * s, std::sin(s), std::cos(s))); };
  for (int i = 0; i < 2000; ++i) fast.push_back({i * 5 * kMs, pose_at(0.005 * i)});
  for (int i = 0; i < 300; ++i) slow.push_back({i * 33 * kMs, pose_at(0.033 * i)});
  const auto e = evaluate_trajectory(fast, slow);
  ASSERT_TRUE(e);
  EXPECT_EQ(e->pairs, 300u);
  EXPECT_LT(e->absolute_m.max, 0.003);
}

TEST(TrajectoryEvaluation, RelativeErrorsAreOverTheIntervalThatIsNearest) {
  StampedPoses reference, estimate;
  for (int i = 0; i < 60; ++i) {
    const std::int64_t stamp_ns = i * 500 * kMs + (i % 3 == 0 ? 2 : 0) * kMs;  // of 2 Hz, which jitters
    reference.push_back({stamp_ns, SE3(Quaternion::Identity(), Vec3(0.0, std::sin(0.5 * i), 0.0))});
    estimate.push_back(reference.back());
    estimate.back().T_world_camera.t.x() += 0.01e-9 * static_cast<double>(stamp_ns);
  }
  const auto e = evaluate_trajectory(estimate, reference, false, Alignment{});
  ASSERT_TRUE(e);
  EXPECT_EQ(e->relative_m.count, 57u);
  EXPECT_NEAR(e->relative_m.max, 0.01, 0.0001) << "in 1 s, not in 1.5 s";
}

TEST(TrajectoryEvaluation, RelativeErrorsGoOnBehindAHoleOfTheFasterOne) {
  StampedPoses fast, slow;
  const auto pose_at = [](double s) { return SE3(Quaternion::Identity(), Vec3(0.5 * s, std::sin(s), std::cos(s))); };
  for (int i = 0; i < 2000; ++i) {
    if (i <= 400 || i >= 405) fast.push_back({i * 5 * kMs, pose_at(0.005 * i)});  // 25 ms are missing
  }
  for (int i = 0; i < 1000; ++i) slow.push_back({i * 10 * kMs, pose_at(0.01 * i)});
  const auto e = evaluate_trajectory(fast, slow);
  ASSERT_TRUE(e);
  EXPECT_GE(e->relative_m.count, 895u);
}

TEST(TrajectoryEvaluation, NoRelativeErrorAcrossAGap) {
  StampedPoses reference = make_path(40);
  for (std::size_t i = 20; i < 40; ++i) reference[i].stamp_ns += 5000 * kMs;
  const auto e = evaluate_trajectory(reference, reference);
  ASSERT_TRUE(e);
  EXPECT_EQ(e->pairs, 40u);
  EXPECT_EQ(e->relative_m.count, 0u);
}

TEST(TrajectoryEvaluation, TooFewPairsAreAnError) {
  StampedPoses late = make_path(50);
  for (StampedPose& pose : late) pose.stamp_ns += 1000000 * kMs;
  EXPECT_NE(evaluate_trajectory(late, make_path(50)).message().find("0 poses have a partner"), std::string::npos);
  EXPECT_NE(evaluate_trajectory(make_path(2), make_path(50)).message().find("2 poses"), std::string::npos);
}

TEST(TrajectoryEvaluation, OrbSlam2OnFr2Desk) {
  const auto estimate_path = shared_data("tum/fr2_desk/orbslam2_rgbd_trajectory.txt");
  const auto truth_path = shared_data("tum/fr2_desk/groundtruth.txt");
  if (!estimate_path || !truth_path) GTEST_SKIP() << "SEMANTIC_TOPO_LOOP_DATA is not set";
  const auto estimate = read_tum_trajectory(*estimate_path);
  const auto truth = read_tum_ground_truth(*truth_path);
  ASSERT_TRUE(estimate && truth) << estimate.message() << truth.message();
  const auto e = evaluate_trajectory(*estimate, *truth);
  ASSERT_TRUE(e) << e.message();
  EXPECT_EQ(e->pairs, 2225u);
  EXPECT_NEAR(e->absolute_m.rmse, 0.0081, 0.00005);
}

}  // namespace
}  // namespace semantic_topo_loop::core
