#include "odometry/held_poses.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <optional>
#include <vector>

#include "semantic_topo_loop/geometry/lie.h"
#include "support/synthetic_run.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::int64_t kInterval_ns = 33'333'333;

/// A camera on its way along x at 0.3 m/s, which turns at 0.4 rad/s.
SE3 way(double seconds) { return {so3_exp(Vec3(0.0, 0.4 * seconds, 0.0)), Vec3(0.3 * seconds, 0.0, 0.0)}; }
double seconds(int image) { return 1e-9 * static_cast<double>(image * kInterval_ns); }

/// Which of so many images are held, if the odometry's pose at each is that of another one.
std::vector<bool> held_images(int images, const std::function<int(int)>& pose_of) {
  HeldPoses poses;
  std::vector<bool> held;
  for (int i = 0; i < images; ++i) held.push_back(poses.is_held(i * kInterval_ns, way(seconds(pose_of(i)))));
  return held;
}

TEST(HeldPoses, OfAnOdometryAtFiveHertzEverySixthImageHasAPose) {
  const std::vector<bool> held = held_images(300, [](int i) { return i / 6 * 6; });
  for (int i = 12; i < 300; ++i) EXPECT_EQ(held[static_cast<std::size_t>(i)], i % 6 != 0) << i;
}

TEST(HeldPoses, RoundingMakesNoNewPose) {
  HeldPoses poses;
  Random random(1);
  for (int i = 0; i < 300; ++i) {
    SE3 pose = way(seconds(i / 6 * 6));
    pose.t += 1e-15 * random.normal3();
    const bool is_held = poses.is_held(i * kInterval_ns, pose);
    if (i >= 12) {
      EXPECT_EQ(is_held, i % 6 != 0) << i;
    }
  }
}

TEST(HeldPoses, ARobotThatParksIsSeenAgainSoon) {
  static constexpr int kParked = 300;
  const std::vector<bool> held = held_images(400, [](int i) { return std::min(i, kParked) / 6 * 6; });
  for (int i = kParked + 12; i < 400; ++i) EXPECT_FALSE(held[static_cast<std::size_t>(i)]) << i;
}

TEST(HeldPoses, AnOdometryAtTheImagesRateIsNeverHeld) {
  // It stands for a second now and then.
  const std::vector<bool> held = held_images(600, [](int i) { return i % 100 < 30 ? i / 100 * 100 : i; });
  for (std::size_t i = 0; i < held.size(); ++i) EXPECT_FALSE(held[i]) << i;
}

/// Moves for two seconds, stands for `stood` images, and is at `end` with the next.
std::optional<std::int64_t> after_standing(int stood, const std::function<SE3(double)>& end) {
  constexpr int kMoving = 60;
  HeldPoses poses;
  for (int i = 0; i <= kMoving + stood; ++i) {
    const auto since = poses.move(i * kInterval_ns, way(seconds(std::min(i, kMoving)))).caught_up_since_ns;
    EXPECT_FALSE(since) << i;
  }
  const int next = kMoving + stood + 1;
  const auto since_ns = poses.move(next * kInterval_ns, end(seconds(next))).caught_up_since_ns;
  EXPECT_EQ(since_ns.value_or(kMoving * kInterval_ns), kMoving * kInterval_ns);
  EXPECT_FALSE(poses.move((next + 1) * kInterval_ns, end(seconds(next + 1))).caught_up_since_ns) << "once";
  return since_ns;
}

TEST(HeldPoses, AnOdometryThatFindsItsWayAgainHasCaughtUp) {
  for (const int stood : {6, 15, 30, 45}) EXPECT_TRUE(after_standing(stood, way)) << stood;
}

TEST(HeldPoses, OneThatGoesOnFromWhereItStoodHasMissedTheWay) {
  for (const int stood : {6, 15, 30, 45}) {
    const double missed_s = seconds(stood);
    EXPECT_FALSE(after_standing(stood, [missed_s](double s) { return way(s - missed_s); })) << stood;
    EXPECT_FALSE(after_standing(stood, [missed_s](double s) { return way(2.0 * s - 2.0 * missed_s - 2.0); }))
        << stood << ", twice as fast";
  }
}

TEST(HeldPoses, AJumpIsNoWay) {
  EXPECT_FALSE(after_standing(10, [](double s) { return SE3(Quaternion::Identity(), Vec3(0.0, 1.0, 0.0)) * way(s); }));
  EXPECT_FALSE(after_standing(10, [](double s) { return way(s) * SE3(so3_exp(Vec3(1.5, 0.0, 0.0)), Vec3::Zero()); }));
  EXPECT_FALSE(after_standing(90, way)) << "lost for three seconds";
  EXPECT_FALSE(after_standing(0, [](double s) { return way(s) * SE3(Quaternion::Identity(), Vec3(0.05, 0.0, 0.0)); }))
      << "it did not stand";
}

TEST(HeldPoses, OverAGapTheWayGoesOn) {
  const auto after = [](double gap_s, const std::function<SE3(double)>& end) {
    constexpr int kMoving = 60;
    HeldPoses poses;
    for (int i = 0; i <= kMoving; ++i) poses.move(i * kInterval_ns, way(seconds(i)));
    const std::int64_t gap_ns = std::llround(1e9 * gap_s);
    return poses.move(kMoving * kInterval_ns + gap_ns, end(seconds(kMoving) + gap_s));
  };
  for (const double gap_s : {0.5, 1.2, 1.9}) {
    EXPECT_TRUE(after(gap_s, way).is_way) << gap_s;
    EXPECT_FALSE(after(gap_s, way).caught_up_since_ns) << gap_s;
    EXPECT_FALSE(after(gap_s, [](double) { return SE3(Quaternion::Identity(), Vec3(0.0, 0.0, 5.0)); }).is_way) << gap_s;
    EXPECT_FALSE(after(gap_s, [](double) { return way(seconds(60)); }).is_way) << gap_s << ": it may have stood";
  }
  EXPECT_FALSE(after(2.5, way).is_way);
}

TEST(HeldPoses, NothingIsHeldAcrossABreak) {
  for (const bool is_break : {false, true}) {
    HeldPoses poses;
    for (int i = 0; i < 4; ++i) poses.move(i * kInterval_ns, SE3());
    if (is_break) poses.begin_anew();
    const SE3 turned(so3_exp(Vec3(0.0, 0.0, 0.05)), Vec3::Zero());
    EXPECT_EQ(poses.move(4 * kInterval_ns, turned).caught_up_since_ns.has_value(), !is_break);
  }
}

TEST(HeldPoses, FramesBetweenWereOnTheWayAndOthersWhereTheyWere) {
  Frame later;
  later.stamp_ns = 5 * kInterval_ns;
  later.T_odom_camera.t = Vec3(1.0, 0.0, 0.0);
  EXPECT_EQ(pose_on_the_way(3 * kInterval_ns, SE3(), later).t, Vec3::Zero()) << "nothing was held";
  later.held_since_ns = kInterval_ns;
  for (int i = 0; i < 8; ++i) {
    const double x = pose_on_the_way(i * kInterval_ns, SE3(), later).t.x();
    EXPECT_NEAR(x, i > 0 && i < 5 ? 0.25 * (i - 1) : 0.0, 1e-12) << i;
  }
  constexpr auto kLeast = std::numeric_limits<std::int64_t>::min(), kMost = std::numeric_limits<std::int64_t>::max();
  later.held_since_ns = kLeast;
  later.stamp_ns = kMost;
  EXPECT_NEAR(pose_on_the_way(0, SE3(), later).t.x(), 0.5, 1e-12);
  later.held_since_ns = kMost;
  EXPECT_EQ(pose_on_the_way(0, SE3(), later).t, Vec3::Zero());
}

TEST(HeldPoses, StampsThatDoNotRiseAreNoMotion) {
  HeldPoses poses;
  EXPECT_FALSE(poses.move(kInterval_ns, way(0.0)).caught_up_since_ns);
  EXPECT_FALSE(poses.move(2 * kInterval_ns, way(0.0)).caught_up_since_ns);
  EXPECT_FALSE(poses.move(0, way(1.0)).caught_up_since_ns);
  EXPECT_FALSE(poses.move(0, way(2.0)).caught_up_since_ns);
}

}  // namespace
}  // namespace semantic_topo_loop::core
