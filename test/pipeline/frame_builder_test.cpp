#include "semantic_topo_loop/pipeline/frame_builder.h"

#include <gtest/gtest.h>

#include <limits>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::int64_t kPeriod_ns = 33333333;

class FrameBuilderTest : public ::testing::Test {
 protected:
  Result<Frame> build(const Vec3& position, double yaw_deg = 0.0, std::int64_t step_ns = kPeriod_ns) {
    stamp_ns_ += step_ns;
    return builder_.build({stamp_ns_, SE3(so3_exp(Vec3(0.0, 0.0, radians(yaw_deg))), position)});
  }

  FrameBuilder builder_{KeyframeOptions{}, Camera{500.0, 500.0, 320.0, 240.0, 640, 480, {}}};
  std::int64_t stamp_ns_ = 0;
};

TEST_F(FrameBuilderTest, NumbersFramesAndHangsThemOnKeyframes) {
  for (int i = 0; i < 10; ++i) {
    const auto frame = build(Vec3(0.03 * i, 0.0, 0.0));
    ASSERT_TRUE(frame) << frame.message();
    EXPECT_EQ(frame->frame_id, i);
    EXPECT_EQ(frame->is_keyframe, i % 4 == 0) << i;  // 0.10 m after the last keyframe
    EXPECT_EQ(frame->keyframe_id, i / 4);
    EXPECT_FALSE(frame->is_break);
  }
}

TEST_F(FrameBuilderTest, RotationAndTimeMakeKeyframesToo) {
  EXPECT_TRUE(build(Vec3::Zero()));
  EXPECT_FALSE(build(Vec3::Zero(), 5.0)->is_keyframe);
  EXPECT_TRUE(build(Vec3::Zero(), 8.0)->is_keyframe);
  EXPECT_FALSE(build(Vec3::Zero(), 8.0, 900000000)->is_keyframe);
  EXPECT_TRUE(build(Vec3::Zero(), 8.5, 200000000)->is_keyframe);
}

TEST_F(FrameBuilderTest, AParkedRobotMakesNoKeyframesAndAMovedOneAtOnce) {
  ASSERT_TRUE(build(Vec3::Zero()));
  for (int i = 0; i < 1000; ++i) {
    const auto frame = build(Vec3(0.001 * (i % 3), 0.0, 0.0), 0.05 * (i % 2), 500000000);
    ASSERT_TRUE(frame);
    EXPECT_FALSE(frame->is_keyframe || frame->is_break);
    EXPECT_EQ(frame->keyframe_id, 0);
  }
  EXPECT_TRUE(build(Vec3(0.02, 0.0, 0.0))->is_keyframe);
  EXPECT_FALSE(build(Vec3(0.04, 0.0, 0.0))->is_keyframe);
}

TEST_F(FrameBuilderTest, AHiccupOfAFastCameraIsNoBreak) {
  EXPECT_TRUE(build(Vec3::Zero()));
  EXPECT_FALSE(build(Vec3(0.15, 0.0, 0.0), 0.0, 3'000'000)->is_break) << "50 m/s, and 6 m/s over the time of a frame";
  EXPECT_TRUE(build(Vec3(0.45, 0.0, 0.0), 0.0, 3'000'000)->is_break);
}

TEST_F(FrameBuilderTest, JumpOfTheOdometryAndAGapAreBreaks) {
  EXPECT_TRUE(build(Vec3::Zero()));
  EXPECT_FALSE(build(Vec3(0.15, 0.0, 0.0))->is_break);
  const auto jump = build(Vec3(0.6, 0.0, 0.0));
  EXPECT_TRUE(jump->is_break);
  EXPECT_TRUE(jump->is_keyframe);
  EXPECT_TRUE(build(Vec3(0.6, 0.0, 0.0), 40.0)->is_break);
  const auto gap = build(Vec3(0.6, 0.0, 0.0), 40.0, 2000000000);
  EXPECT_TRUE(gap->is_break);
  EXPECT_TRUE(gap->is_keyframe) << "though nothing has moved";
  EXPECT_FALSE(builder_.end().is_break);
}

TEST_F(FrameBuilderTest, AGapThatTheOdometryGoesOnOverIsNoBreak) {
  for (int i = 0; i < 30; ++i) ASSERT_TRUE(build(Vec3(0.01 * i, 0.0, 0.0)));
  EXPECT_FALSE(build(Vec3(0.75, 0.0, 0.0), 0.0, 1'500'000'000)->is_break);
  EXPECT_TRUE(build(Vec3(2.75, 0.0, 0.0), 0.0, 1'500'000'000)->is_break) << "more than three times as fast as before";
  for (int i = 0; i < 30; ++i) ASSERT_TRUE(build(Vec3(2.75 + 0.01 * i, 0.0, 0.0)));
  EXPECT_TRUE(build(Vec3(4.0, 0.0, 0.0))->is_break);
  EXPECT_TRUE(build(Vec3(7.0, 0.0, 0.0), 0.0, 1'500'000'000)->is_break) << "a jump is no speed";
}

TEST_F(FrameBuilderTest, AGapThatTheSourceVouchesForIsNoBreak) {
  ASSERT_TRUE(build(Vec3::Zero()));
  PoseSample sample;
  sample.is_continuous = true;
  sample.T_odom_camera.t = Vec3(2.0, 0.0, 0.0);
  sample.stamp_ns = stamp_ns_ + 5'000'000'000;
  EXPECT_FALSE(builder_.build(sample)->is_break);
  sample.T_odom_camera.t = Vec3(50.0, 0.0, 0.0);
  sample.stamp_ns += 5'000'000'000;
  EXPECT_TRUE(builder_.build(sample)->is_break) << "no camera moves so fast";
}

TEST_F(FrameBuilderTest, WhatTheOdometryCatchesUpIsNoBreak) {
  double x = 0.0;
  for (int i = 0; i < 30; ++i) ASSERT_TRUE(build(Vec3(x = 0.02 * i, 0.0, 0.0)));
  const std::int64_t held_ns = stamp_ns_;
  for (int i = 0; i < 20; ++i) EXPECT_FALSE(build(Vec3(x, 0.0, 0.0))->held_since_ns) << i;
  const auto frame = build(Vec3(x + 21 * 0.02, 0.0, 0.0));
  EXPECT_FALSE(frame->is_break) << "0.42 m in a frame";
  ASSERT_TRUE(frame->held_since_ns);
  EXPECT_EQ(*frame->held_since_ns, held_ns);
  EXPECT_FALSE(builder_.end().held_since_ns);
  EXPECT_TRUE(build(Vec3(x + 2.0, 0.0, 0.0))->is_break) << "the next is none";
}

TEST_F(FrameBuilderTest, RefusesBadInputByNameAndGoesOn) {
  ASSERT_TRUE(build(Vec3::Zero()));
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_NE(build(Vec3(nan, 0.0, 0.0)).message().find("not finite"), std::string::npos);
  EXPECT_NE(build(Vec3::Zero(), 0.0, -kPeriod_ns).message().find("not after"), std::string::npos);
  const auto next = build(Vec3::Zero(), 0.0, kPeriod_ns);
  ASSERT_TRUE(next);
  EXPECT_EQ(next->frame_id, 1);
}

TEST_F(FrameBuilderTest, EndFollowsTheLastFrame) {
  ASSERT_TRUE(build(Vec3::Zero()));
  ASSERT_TRUE(build(Vec3::Zero()));
  const Frame end = builder_.end();
  EXPECT_TRUE(end.is_end);
  EXPECT_FALSE(end.is_keyframe);
  EXPECT_EQ(end.frame_id, 2);
}

}  // namespace
}  // namespace semantic_topo_loop::core
