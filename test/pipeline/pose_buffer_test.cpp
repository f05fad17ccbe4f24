#include "semantic_topo_loop/pipeline/pose_buffer.h"

#include <gtest/gtest.h>

#include <limits>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::int64_t kStart_ns = 1311868164363181000;
constexpr std::int64_t kMillisecond_ns = 1000000;

std::int64_t at_ms(std::int64_t milliseconds) { return kStart_ns + milliseconds * kMillisecond_ns; }

/// Moves along x by 1 m/s and turns about z by 1 rad/s.
SE3 pose_at(double time_s) { return {so3_exp(Vec3(0.0, 0.0, time_s)), Vec3(time_s, 2.0, 3.0)}; }

PoseBuffer filled(double max_gap_s, std::initializer_list<int> times_ms) {
  PoseBuffer buffer(max_gap_s);
  for (const int time_ms : times_ms) EXPECT_TRUE(buffer.add(at_ms(time_ms), pose_at(1e-3 * time_ms)));
  return buffer;
}

TEST(PoseBuffer, InterpolatesBetweenTwoSamples) {
  const PoseBuffer buffer = filled(0.1, {0, 50, 100});
  for (const int time_ms : {1, 25, 49, 60, 99}) {
    const PoseBuffer::Answer answer = buffer.at(at_ms(time_ms));
    ASSERT_EQ(answer.status, PoseBuffer::Status::kFound) << time_ms;
    const SE3 expected = pose_at(1e-3 * time_ms);
    EXPECT_LT((answer.pose.t - expected.t).norm(), 1e-12) << time_ms;
    EXPECT_LT(rotation_angle(answer.pose.q, expected.q), 1e-9) << time_ms;
  }
}

TEST(PoseBuffer, GivesASampleBackAsItWasGiven) {
  const PoseBuffer buffer = filled(0.1, {0, 50, 1000});
  for (const int time_ms : {0, 50, 1000}) {
    const PoseBuffer::Answer answer = buffer.at(at_ms(time_ms));
    ASSERT_EQ(answer.status, PoseBuffer::Status::kFound) << time_ms;
    EXPECT_EQ(answer.pose.t, pose_at(1e-3 * time_ms).t);
  }
}

TEST(PoseBuffer, NeverExtrapolates) {
  EXPECT_EQ(PoseBuffer(0.1).at(kStart_ns).status, PoseBuffer::Status::kNotYet);
  const PoseBuffer buffer = filled(0.1, {0, 50});
  EXPECT_EQ(buffer.at(at_ms(0) - 1).status, PoseBuffer::Status::kTooOld);
  EXPECT_EQ(buffer.at(at_ms(50) + 1).status, PoseBuffer::Status::kNotYet);
}

TEST(PoseBuffer, DoesNotBridgeAGap) {
  const PoseBuffer buffer = filled(0.1, {0, 100, 201, 250});
  EXPECT_EQ(buffer.at(at_ms(50)).status, PoseBuffer::Status::kFound) << "a gap of exactly the maximum counts";
  EXPECT_EQ(buffer.at(at_ms(150)).status, PoseBuffer::Status::kGap);
  EXPECT_EQ(buffer.at(at_ms(225)).status, PoseBuffer::Status::kFound);
}

TEST(PoseBuffer, TellsWhetherItKnowsTheWayBetweenTwoStamps) {
  const PoseBuffer buffer = filled(0.1, {0, 100, 201, 250, 300});
  EXPECT_TRUE(buffer.is_continuous(at_ms(0), at_ms(100)));
  EXPECT_TRUE(buffer.is_continuous(at_ms(210), at_ms(290)));
  EXPECT_TRUE(buffer.is_continuous(at_ms(201), at_ms(300)));
  EXPECT_FALSE(buffer.is_continuous(at_ms(50), at_ms(150)));
  EXPECT_FALSE(buffer.is_continuous(at_ms(50), at_ms(290)));
  EXPECT_FALSE(buffer.is_continuous(at_ms(-10), at_ms(50))) << "begins before the first";
  EXPECT_FALSE(buffer.is_continuous(at_ms(210), at_ms(310))) << "ends after the last";
}

TEST(PoseBuffer, SortsALateSampleIn) {
  PoseBuffer buffer = filled(0.1, {0, 100, 200});
  ASSERT_EQ(filled(0.1, {0, 200}).at(at_ms(150)).status, PoseBuffer::Status::kGap);
  PoseBuffer late = filled(0.1, {0, 200});
  ASSERT_TRUE(late.add(at_ms(100), pose_at(0.1)));
  EXPECT_EQ(late.at(at_ms(150)).pose.t, buffer.at(at_ms(150)).pose.t);
}

TEST(PoseBuffer, RefusesBadSamplesAndNamesTheValue) {
  PoseBuffer buffer = filled(0.1, {0});
  SE3 bad = pose_at(0.0);
  bad.t.y() = std::numeric_limits<double>::quiet_NaN();
  const std::string error = buffer.add(at_ms(10), bad).message();
  EXPECT_NE(error.find("translation"), std::string::npos) << error;
  EXPECT_NE(error.find("nan"), std::string::npos) << error;

  bad = pose_at(0.0);
  bad.q.coeffs() *= 1.5;
  EXPECT_NE(buffer.add(at_ms(10), bad).message().find("norm 1.5"), std::string::npos);

  bad.q.w() = std::numeric_limits<double>::infinity();
  EXPECT_NE(buffer.add(at_ms(10), bad).message().find("not finite"), std::string::npos);

  EXPECT_NE(buffer.add(at_ms(0), pose_at(0.0)).message().find("1311868164363181000"), std::string::npos);
  EXPECT_EQ(buffer.at(at_ms(10)).status, PoseBuffer::Status::kNotYet) << "nothing bad was taken";
}

TEST(PoseBuffer, ForgetsOldSamples) {
  PoseBuffer buffer(1e6, 1.0);
  for (int time_ms = 0; time_ms <= 5000; time_ms += 50) {
    ASSERT_TRUE(buffer.add(at_ms(time_ms), pose_at(1e-3 * time_ms)));
  }
  EXPECT_EQ(buffer.at(at_ms(3999)).status, PoseBuffer::Status::kTooOld);
  EXPECT_EQ(buffer.at(at_ms(4001)).status, PoseBuffer::Status::kFound);
  EXPECT_FALSE(buffer.add(at_ms(3000), pose_at(3.0)));
  buffer.clear();
  EXPECT_TRUE(buffer.empty());
  EXPECT_TRUE(buffer.add(at_ms(0), pose_at(0.0))) << "after clear, time may start anew";
}

}  // namespace
}  // namespace semantic_topo_loop::core
