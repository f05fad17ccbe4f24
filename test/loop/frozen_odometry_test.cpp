#include "loop/submap/frozen_odometry.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <random>
#include <vector>

#include "loop/submap/submap_builder.h"
#include "loop/submap/window_solver.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "support/synthetic_desk.h"

namespace semantic_topo_loop::core {
namespace {

using testing::desk_camera;
using testing::desk_classes;
using testing::DeskObject;
using testing::random_desk;

constexpr double kRate_hz = 10.0, kEnd_s = 6.0, kFreeze_s = 2.5, kThaw_s = 3.5;

/// On its way around the desk.
SE3 moving(double time_s) { return testing::desk_pose({{0.0, kEnd_s, 0.0, 60.0}}, time_s); }
SE3 parked(double) { return moving(1.0); }

struct Watched {
  std::deque<ObservedFrame> window;
  std::vector<SE3> truth;
};

/// Frames of a camera whose odometry stands still for a second, and goes on from where it stood.
/// @param desk_at where the things are at a time
Watched watch(const std::function<SE3(double)>& camera_at,
              const std::function<std::vector<DeskObject>(double)>& desk_at, std::uint64_t seed) {
  ObservationWindow window(kEnd_s, 0.0, *desk_classes());
  FrameBuilder builder(KeyframeOptions(), desk_camera());
  std::mt19937_64 random(seed);
  Watched watched;
  SE3 T_odom_camera;
  for (int k = 0; k < static_cast<int>(kEnd_s * kRate_hz); ++k) {
    const double time_s = k / kRate_hz;
    const SE3 pose = camera_at(time_s);
    const bool is_frozen = time_s > kFreeze_s && time_s <= kThaw_s;
    if (watched.truth.empty())
      T_odom_camera = pose;
    else if (!is_frozen)
      T_odom_camera = T_odom_camera * (watched.truth.back().inverse() * pose);
    watched.truth.push_back(pose);
    PoseSample sample;
    sample.stamp_ns = std::llround(1e9 * (1.0 + time_s));
    sample.T_odom_camera = T_odom_camera;
    const auto frame = builder.build(sample);
    window.push(*frame, testing::observe(desk_at(time_s), *frame, pose, 0, random));
  }
  watched.window = window.frames();
  return watched;
}

std::function<std::vector<DeskObject>(double)> at_rest(const std::vector<DeskObject>& desk) {
  return [desk](double) { return desk; };
}

TEST(FrozenOdometry, IsFoundByWhatMovesInView) {
  for (const std::uint64_t seed : {1, 2, 3, 4, 5}) {
    const Watched watched = watch(moving, at_rest(random_desk(seed, 6)), seed);
    const std::vector<bool> frozen = frozen_motions(watched.window);
    ASSERT_EQ(frozen.size(), watched.window.size());
    for (std::size_t i = 0; i < frozen.size(); ++i) {
      const double time_s = static_cast<double>(i) / kRate_hz;  // of the frame that the motion starts from
      EXPECT_EQ(frozen[i], time_s >= kFreeze_s && time_s < kThaw_s) << seed << " " << time_s;
    }
    EXPECT_EQ(last_frozen_ns(watched.window), std::llround(1e9 * (1.0 + kThaw_s)));
  }
}

TEST(FrozenOdometry, AParkedCameraIsNotFrozen) {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    EXPECT_EQ(last_frozen_ns(watch(parked, at_rest(random_desk(seed, 6)), seed).window), std::nullopt) << seed;
  }
}

TEST(FrozenOdometry, OneThingMayMoveByItself) {
  for (const std::uint64_t seed : {1, 2, 3}) {
    const auto carried = [desk = random_desk(seed, 6)](double time_s) {
      std::vector<DeskObject> moved = desk;
      moved[0].spheroid.center.x() += 0.2 * time_s;
      return moved;
    };
    EXPECT_EQ(last_frozen_ns(watch(parked, carried, seed).window), std::nullopt) << seed;
  }
}

TEST(FrozenOdometry, NothingInViewTellsNothing) {
  EXPECT_EQ(last_frozen_ns(watch(moving, at_rest({}), 1).window), std::nullopt);
  EXPECT_EQ(last_frozen_ns({}), std::nullopt);
  EXPECT_TRUE(frozen_motions({}).empty());
}

TEST(FrozenOdometry, BoxesTellHowTheCameraTurned) {
  const auto desk = random_desk(3, 8);
  for (const Vec3& turn : {Vec3(0.0, 0.05, 0.0), Vec3(-0.04, 0.0, 0.0), Vec3(0.03, -0.06, 0.0)}) {
    const auto turning = [&turn](double time_s) {
      const double share = (time_s - kFreeze_s) / (kThaw_s - kFreeze_s);
      return moving(1.0) * SE3(so3_exp(std::min(std::max(share, 0.0), 1.0) * turn), Vec3::Zero());
    };
    const Watched watched = watch(turning, at_rest(desk), 1);
    const Quaternion found = turn_by_boxes(watched.window.front(), watched.window.back());
    EXPECT_LT(degrees(rotation_angle(found, so3_exp(turn))), 0.5) << turn.transpose();
  }
  EXPECT_EQ(turn_by_boxes(ObservedFrame(), ObservedFrame()).coeffs(), Quaternion::Identity().coeffs());
}

TEST(FrozenOdometry, WhatItMissedIsSolvedFor) {
  for (const std::uint64_t seed : {1, 2, 3}) {
    const Watched watched = watch(moving, at_rest(random_desk(seed, 8)), seed);
    const std::size_t anchor = middle_keyframe(watched.window).value();
    const std::deque<ObservedFrame> solved = WindowSolver().solve(watched.window, anchor);
    const auto error = [&](const std::deque<ObservedFrame>& frames) {
      const SE3 right = watched.truth.front().inverse() * watched.truth.back();
      return se3_log(right.inverse() * (frames.front().T_odom_camera.inverse() * frames.back().T_odom_camera));
    };
    EXPECT_GT(error(watched.window).head<3>().norm(), 0.25);
    EXPECT_LT(error(solved).head<3>().norm(), 0.04) << seed;
    EXPECT_LT(degrees(error(solved).tail<3>().norm()), 1.5) << seed;
    double frozen_s = 0.0;
    for (const ObservedFrame& frame : solved) frozen_s += frame.frozen_s;
    EXPECT_NEAR(frozen_s, kThaw_s - kFreeze_s, 1e-6);
  }
}

}  // namespace
}  // namespace semantic_topo_loop::core
