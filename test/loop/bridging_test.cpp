#include "loop/submap/bridging.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <functional>
#include <string>

#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kInterval_s = 0.09;

/// Frames of a camera, and which of its motions the odometry did not follow.
struct Recording {
  std::deque<ObservedFrame> window, truth;
  std::vector<bool> frozen;

  void add(double time_s, const SE3& T_world_camera, bool is_frozen) {
    ObservedFrame frame;
    frame.stamp_ns = std::llround(1e9 * (1.0 + time_s));
    frame.T_odom_camera = T_world_camera;
    truth.push_back(frame);
    if (!window.empty()) {
      const SE3 motion = truth[truth.size() - 2].T_odom_camera.inverse() * T_world_camera;
      frame.T_odom_camera = window.back().T_odom_camera * (frozen.back() ? SE3() : motion);
    }
    window.push_back(frame);
    frozen.push_back(is_frozen);
  }
};

/// @param is_frozen from a time on to the next frame
Recording record(const std::function<SE3(double)>& camera_at, const std::function<bool(double)>& is_frozen) {
  Recording recording;
  for (double time_s = 0.0; time_s < 6.0; time_s += kInterval_s) {
    recording.add(time_s, camera_at(time_s), is_frozen(time_s));
  }
  return recording;
}

bool is_second(double time_s) { return time_s >= 2.5 && time_s < 3.5; }

SE3 accelerating(double time_s) {
  return {so3_exp(Vec3(0.0, 0.0, 0.05 * time_s * time_s)), Vec3(0.1 * time_s * time_s, 0.2 * time_s, 0.0)};
}

SE3 motion(const std::deque<ObservedFrame>& window, std::size_t from, std::size_t to) {
  return window[from].T_odom_camera.inverse() * window[to].T_odom_camera;
}

Vec6 error(const Recording& recording, std::size_t from, std::size_t to) {
  return se3_log(motion(recording.truth, from, to).inverse() * motion(recording.window, from, to));
}

TEST(Bridge, AnEvenlyAcceleratedCameraGoesOnAsItDid) {
  Recording recording = record(accelerating, is_second);
  const std::size_t last = recording.window.size() - 1;
  EXPECT_GT(error(recording, 0, last).head<3>().norm(), 0.4);
  const auto bridged = bridge(recording.frozen, 0, &recording.window);
  EXPECT_LT(error(recording, 0, last).head<3>().norm(), 0.02);
  EXPECT_LT(error(recording, 0, last).tail<3>().norm(), 0.005);
  for (std::size_t i = 0; i < last; ++i) {
    EXPECT_LT(error(recording, 0, i).head<3>().norm(), 0.02) << i;  // on the way too
    const bool is_next = (i > 0 && recording.frozen[i - 1]) || recording.frozen[i + 1];
    EXPECT_EQ(bridged[i].has_value(), recording.frozen[i] || is_next) << i;
  }
}

TEST(Bridge, WhatTheOdometryFollowedIsLeftAndTheAnchorStays) {
  for (const std::size_t anchor : {std::size_t{3}, std::size_t{32}, std::size_t{60}}) {
    const Recording given = record(accelerating, is_second);
    std::deque<ObservedFrame> window = given.window;
    const auto bridged = bridge(given.frozen, anchor, &window);
    EXPECT_LT(se3_log(given.window[anchor].T_odom_camera.inverse() * window[anchor].T_odom_camera).norm(), 1e-12);
    for (std::size_t i = 0; i + 1 < window.size(); ++i) {
      if (bridged[i]) continue;
      EXPECT_LT(se3_log(motion(given.window, i, i + 1).inverse() * motion(window, i, i + 1)).norm(), 1e-12) << i;
    }
  }
}

TEST(Bridge, AStretchWithoutVelocitiesOnBothSidesStays) {
  const auto expect_untouched = [](const std::function<bool(double)>& is_frozen) {
    const Recording given = record(accelerating, is_frozen);
    std::deque<ObservedFrame> window = given.window;
    for (const auto& variances : bridge(given.frozen, 5, &window)) EXPECT_FALSE(variances);
    for (std::size_t i = 0; i < window.size(); ++i) {
      EXPECT_LT(se3_log(given.window[i].T_odom_camera.inverse() * window[i].T_odom_camera).norm(), 1e-12) << i;
    }
  };
  expect_untouched([](double time_s) { return time_s < 1.0; });
  expect_untouched([](double time_s) { return time_s > 0.1 && time_s < 1.0; });
  expect_untouched([](double time_s) { return time_s > 5.0; });
  expect_untouched([](double) { return true; });
  std::deque<ObservedFrame> none;
  EXPECT_TRUE(bridge({}, 0, &none).empty());
}

TEST(Bridge, WithoutAFreezeTheBytesAreTheSame) {
  const Recording given = record(accelerating, [](double) { return false; });
  std::deque<ObservedFrame> window = given.window;
  bridge(given.frozen, 7, &window);
  for (std::size_t i = 0; i < window.size(); ++i) {
    EXPECT_EQ(window[i].T_odom_camera.t, given.window[i].T_odom_camera.t);
    EXPECT_EQ(window[i].T_odom_camera.q.coeffs(), given.window[i].T_odom_camera.q.coeffs());
  }
}

TEST(Bridge, AMomentBetweenTwoFreezesIsBridgedWithThem) {
  const auto twice = [](double time_s) { return time_s > 2.0 && time_s < 3.0 && std::abs(time_s - 2.5) > 0.05; };
  Recording recording = record(accelerating, twice);
  const auto bridged = bridge(recording.frozen, 0, &recording.window);
  for (std::size_t i = 0; i < bridged.size(); ++i) {
    const double time_s = static_cast<double>(i) * kInterval_s;
    EXPECT_TRUE(bridged[i] || time_s < 2.0 || time_s > 3.0) << time_s;
  }
  EXPECT_LT(error(recording, 0, recording.window.size() - 1).head<3>().norm(), 0.02);
}

/// Cameras in a hand, as the motion capture has them.
TEST(Bridge, RecordedCamerasGoWhereTheVariancesTell) {
  for (const char* const sequence : {"fr1_xyz", "fr2_desk", "fr3_office"}) {
    const auto path = shared_data(std::string("tum/") + sequence + "/groundtruth.txt");
    if (!path) GTEST_SKIP() << "SEMANTIC_TOPO_LOOP_DATA is not set";
    const StampedPoses poses = checked(read_tum_ground_truth(*path));
    const auto begin_ns = poses.front().stamp_ns;
    double squares = 0.0, squares_of_none = 0.0;
    int count = 0;
    for (const double freeze_s : {0.4, 0.7, 1.0, 1.5}) {
      for (double start_s = 2.0; start_s < 20.0; start_s += 0.9) {
        Recording recording;
        std::int64_t next_ns = 0;
        for (const auto& [stamp_ns, pose] : poses) {
          const double time_s = 1e-9 * static_cast<double>(stamp_ns - begin_ns) - start_s;
          if (time_s < -3.0 || time_s > 4.0 || stamp_ns < next_ns) continue;
          next_ns = stamp_ns + std::llround(1e9 * kInterval_s);
          recording.add(time_s, pose, time_s >= 0.0 && time_s < freeze_s);
        }
        const std::size_t last = recording.window.size() - 1;
        const Vec6 without = error(recording, 0, last);
        const auto bridged = bridge(recording.frozen, 0, &recording.window);
        std::size_t from = 0, to = 0;
        Vec6 variances = Vec6::Zero();
        for (std::size_t i = 0; i <= last; ++i) {
          if (!bridged[i]) continue;
          if (variances.isZero()) from = i;
          to = i + 1;
          variances += *bridged[i];
        }
        if (to == 0) continue;  // a hole of the motion capture
        squares += error(recording, from, to).cwiseAbs2().cwiseQuotient(variances).mean();
        squares_of_none += without.cwiseAbs2().cwiseQuotient(variances).mean();
        ++count;
      }
    }
    ASSERT_GT(count, 60) << sequence;
    EXPECT_GT(squares / count, 0.2) << sequence;
    EXPECT_LT(squares / count, 2.0) << sequence;
    EXPECT_GT(squares_of_none, squares) << sequence;
  }
}

}  // namespace
}  // namespace semantic_topo_loop::core
