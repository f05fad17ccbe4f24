#include "loop/submap/missed_motion.h"

#include <gtest/gtest.h>

#include <algorithm>
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
#include "odometry/odometry_edge.h"
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

using Odometry = std::function<SE3(const SE3&)>;

SE3 stands_still(const SE3&) { return SE3(); }
SE3 follows(const SE3& motion) { return motion; }
/// By 0.3 m/s and 6 deg/s, of ten frames a second.
SE3 slips(const SE3& motion) { return motion * SE3(so3_exp(Vec3(0.0, 0.0105, 0.0)), Vec3(0.02, 0.01, -0.02)); }

/// Frames of a camera whose odometry is off for a second, or longer, and goes on from where it was.
/// @param desk_at where the things are at a time   @param made_of what it makes of a motion meanwhile
Watched watch(const std::function<SE3(double)>& camera_at,
              const std::function<std::vector<DeskObject>(double)>& desk_at, std::uint64_t seed,
              const Odometry& made_of = stands_still, double thaw_s = kThaw_s, double end_s = kEnd_s) {
  ObservationWindow window(end_s, 0.0, *desk_classes());
  FrameBuilder builder(KeyframeOptions(), desk_camera());
  std::mt19937_64 random(seed);
  Watched watched;
  SE3 T_odom_camera;
  for (int k = 0; k < static_cast<int>(end_s * kRate_hz); ++k) {
    const double time_s = k / kRate_hz;
    const SE3 pose = camera_at(time_s);
    const bool is_off = time_s > kFreeze_s && time_s <= thaw_s;
    if (watched.truth.empty()) {
      T_odom_camera = pose;
    } else {
      const SE3 motion = watched.truth.back().inverse() * pose;
      T_odom_camera = T_odom_camera * (is_off ? made_of(motion) : motion);
    }
    watched.truth.push_back(pose);
    const auto frame = builder.build({std::llround(1e9 * (1.0 + time_s)), T_odom_camera});
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
    for (const ObservedFrame& frame : solved) frozen_s += frame.missed.frozen_s;
    EXPECT_NEAR(frozen_s, kThaw_s - kFreeze_s + 2.0 / kRate_hz, 1e-6);  // the motions before and after, too
  }
}

/// As frames come in, three at a time.
std::deque<ObservedFrame> solved_live(const std::deque<ObservedFrame>& window) {
  WindowSolver solver;
  std::deque<ObservedFrame> seen, solved;
  for (const ObservedFrame& frame : window) {
    seen.push_back(frame);
    if (seen.size() < 12 || seen.size() % 3 != 0) continue;
    solved = solver.solve(seen, middle_keyframe(seen).value());
  }
  return solved;
}

double slipped_s(const std::deque<ObservedFrame>& solved) {
  double sum = 0.0;
  for (const ObservedFrame& frame : solved) sum += frame.missed.slipped_s;
  return sum;
}

TEST(Slip, WhatItMissedIsSolvedForAndHowWellThatIsKnown) {
  Vec6 mean_squares = Vec6::Zero();
  constexpr int kSeeds = 8;
  for (std::uint64_t seed = 1; seed <= kSeeds; ++seed) {
    const Watched watched = watch(moving, at_rest(random_desk(seed, 8)), seed, slips);
    const std::deque<ObservedFrame> solved = solved_live(watched.window);
    ASSERT_EQ(solved.size(), watched.window.size());
    EXPECT_NEAR(slipped_s(solved), kThaw_s - kFreeze_s, 0.4) << seed;
    SE3 made, right;
    MissedMotion missed;
    for (std::size_t i = 1; i < solved.size(); ++i) {
      if (!solved[i].missed.is_any()) continue;
      const SE3 motion = solved[i - 1].T_odom_camera.inverse() * solved[i].T_odom_camera;
      made = made * motion;
      right = right * (watched.truth[i - 1].inverse() * watched.truth[i]);
      missed = join(missed, solved[i].missed, motion);
    }
    const Vec6 error = se3_log(right.inverse() * made);
    EXPECT_LT(error.head<3>().norm(), 0.08) << seed;
    EXPECT_LT(degrees(error.tail<3>().norm()), 2.5) << seed;
    mean_squares += error.cwiseAbs2().cwiseQuotient(missed.covariance.diagonal()) / kSeeds;
  }
  EXPECT_LT(mean_squares.maxCoeff(), 4.0);
  EXPECT_GT(mean_squares.mean(), 0.1);
}

TEST(Slip, AnOdometryThatFollowsIsBelieved) {
  std::mt19937_64 random(1);
  const Odometry shakes = [&random](const SE3& motion) {
    return motion * SE3(so3_exp(0.001 * Vec3(testing::noise(random), testing::noise(random), testing::noise(random))),
                        0.002 * Vec3(testing::noise(random), testing::noise(random), testing::noise(random)));
  };
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    for (const Odometry& odometry : {Odometry(follows), shakes}) {
      EXPECT_EQ(slipped_s(solved_live(watch(moving, at_rest(random_desk(seed, 6)), seed, odometry).window)), 0.0)
          << seed;
    }
  }
}

TEST(Slip, WhatMovesByItselfIsNone) {
  for (const int things : {2, 3, 6}) {
    for (const std::uint64_t seed : {1, 2, 3}) {
      const auto carried = [desk = random_desk(seed, things)](double time_s) {
        std::vector<DeskObject> moved = desk;
        const double since_s = std::min(std::max(time_s - kFreeze_s, 0.0), 1.0);
        moved[0].spheroid.center.x() += 0.4 * since_s;  // each its own way
        moved[1].spheroid.center.y() -= 0.4 * since_s;
        moved[1].spheroid.center.z() += 0.3 * since_s;
        return moved;
      };
      EXPECT_EQ(slipped_s(solved_live(watch(moving, carried, seed, follows).window)), 0.0) << things << " " << seed;
    }
  }
}

TEST(Slip, OneThatGoesOnIsHowTheOdometryIs) {
  constexpr double kAll_s = 16.0;
  const auto around = [](double time_s) { return testing::desk_pose({{0.0, kAll_s, 0.0, 150.0}}, time_s); };
  for (const std::uint64_t seed : {1, 2, 3}) {
    const Watched watched = watch(around, at_rest(random_desk(seed, 8)), seed, slips, kAll_s, kAll_s);
    WindowSolver solver;
    std::deque<ObservedFrame> seen;
    int slipping = 0, later = 0, slipping_later = 0;
    for (const ObservedFrame& frame : watched.window) {
      seen.push_back(frame);
      if (seen.size() < 12 || seen.size() % 3 != 0) continue;
      solver.solve(seen, middle_keyframe(seen).value());
      slipping += solver.is_slipping() ? 1 : 0;
      if (1e-9 * static_cast<double>(frame.stamp_ns) < 1.0 + kFreeze_s + 6.0) continue;
      ++later;
      slipping_later += solver.is_slipping() ? 1 : 0;
    }
    EXPECT_GT(slipping, 5) << seed;
    EXPECT_LT(slipping_later, later / 3) << seed;
  }
}

TEST(Slip, NothingKnownTellsNothing) {
  EXPECT_FALSE(find_slip({}, {}, {}, {}));
  EXPECT_FALSE(find_slip(watch(moving, at_rest(random_desk(1, 6)), 1, slips).window, {}, {}, {}));
  EXPECT_EQ(slipped_s(solved_live(watch(moving, at_rest({}), 1, slips).window)), 0.0);
}

}  // namespace
}  // namespace semantic_topo_loop::core
