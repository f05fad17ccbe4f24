#include "ros/external_loops.h"

#include <gtest/gtest.h>

#include <boost/make_shared.hpp>
#include <cstdint>
#include <string>
#include <vector>

#include "ros/conversions.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop {
namespace {

/// A camera in a curve, with a keyframe every ten frames.
class ExternalLoopsTest : public ::testing::Test {
 protected:
  static constexpr std::int64_t kStart_ns = 5'000'000'000, kPeriod_ns = 100'000'000, kFramesPerKeyframe = 10;

  static std::int64_t stamp_ns(double frame) {
    return kStart_ns + static_cast<std::int64_t>(frame * static_cast<double>(kPeriod_ns));
  }
  static core::SE3 pose(double frame) {
    return {core::so3_exp(core::Vec3(0.0, 0.002 * frame * frame, 0.01 * frame)),
            core::Vec3(0.02 * frame, 0.003 * frame * frame, 0.0)};
  }
  static geometry_msgs::PoseWithCovariance motion() {
    geometry_msgs::PoseWithCovariance motion;
    motion.pose = to_msg(core::SE3(core::so3_exp(core::Vec3(0.1, -0.2, 0.3)), core::Vec3(0.3, 0.1, -0.2)));
    for (std::size_t i = 0; i < 36; i += 7) motion.covariance[i] = 1e-4;
    return motion;
  }

  /// @param jump of the odometry before this frame: a break
  void add_frame(std::int64_t id, const core::SE3& jump = {}) {
    core::Frame frame;
    frame.frame_id = id;
    frame.stamp_ns = stamp_ns(static_cast<double>(id));
    frame.is_break = jump.t.norm() > 0.0;
    frame.is_keyframe = frame.is_break || id % kFramesPerKeyframe == 0;
    keyframe_id_ += frame.is_keyframe ? 1 : 0;
    frame.keyframe_id = keyframe_id_;
    T_odom_world_ = jump * T_odom_world_;
    frame.T_odom_camera = T_odom_world_ * pose(static_cast<double>(id));
    loops_.add(frame);
  }
  void add_frames(std::int64_t begin, std::int64_t end) {
    for (std::int64_t id = begin; id < end; ++id) add_frame(id);
  }
  void add_end() {
    core::Frame frame;
    frame.is_end = true;
    loops_.add(frame);
    loops_.end();
  }
  void ask(double query, double match) {
    auto loop = boost::make_shared<ExternalLoop>();
    loop->header.stamp = to_ros_time(stamp_ns(query));
    loop->match_stamp = to_ros_time(stamp_ns(match));
    loop->match_from_query = motion();
    loops_.add(loop);
  }
  /// Whether the loop says of two keyframes what was asked of two frames, at the poses of all of them.
  static void expect_loop(const core::LoopClosure& loop, double query, double match) {
    const core::SE3 T_match_query = from_msg(motion().pose);
    const core::SE3 expected = pose(static_cast<double>(loop.match_frame)).inverse() * pose(match) * T_match_query *
                               pose(query).inverse() * pose(static_cast<double>(loop.query_frame));
    EXPECT_LT((loop.T_match_query.t - expected.t).norm(), 1e-9) << query << ' ' << match;
    EXPECT_LT(core::rotation_angle(loop.T_match_query.q, expected.q), 1e-7) << query << ' ' << match;
    EXPECT_TRUE(loop.accepted);
  }
  bool is_refused_as(const std::string& why) const {
    return refusals_.size() == 1 && refusals_[0].find(why) != std::string::npos;
  }

  std::vector<std::string> refusals_;
  ExternalLoops loops_{[this](const std::string& problem) { refusals_.push_back(problem); }};
  std::int64_t keyframe_id_ = -1;
  core::SE3 T_odom_world_;
};

TEST_F(ExternalLoopsTest, AnImageIsWhereItsOwnFrameIs) {
  add_frames(0, 41);
  ask(35.0, 4.0);
  const std::vector<core::LoopClosure> loops = loops_.take();
  ASSERT_EQ(loops.size(), 1U);
  EXPECT_EQ(loops[0].query_keyframe_id, 3);
  EXPECT_EQ(loops[0].query_frame, 30);
  EXPECT_EQ(loops[0].query_stamp_ns, stamp_ns(30.0));
  EXPECT_EQ(loops[0].match_keyframe_id, 0);
  EXPECT_EQ(loops[0].match_frame, 0);
  expect_loop(loops[0], 35.0, 4.0);
  EXPECT_TRUE(refusals_.empty());
}

TEST_F(ExternalLoopsTest, AnImageWithoutAFrameIsBetweenTwo) {
  add_frames(0, 41);
  ask(35.5, 30.0);
  ask(25.5, 4.0);
  const std::vector<core::LoopClosure> loops = loops_.take();
  ASSERT_EQ(loops.size(), 1U) << "the first is of one keyframe";
  EXPECT_TRUE(is_refused_as("both are of one keyframe"));
  const core::SE3 between(pose(25.0).q.slerp(0.5, pose(26.0).q), 0.5 * (pose(25.0).t + pose(26.0).t));
  const core::SE3 T_query_keyframe = between.inverse() * pose(20.0);
  const core::SE3 expected = pose(4.0) * from_msg(motion().pose) * T_query_keyframe;
  EXPECT_LT((loops[0].T_match_query.t - expected.t).norm(), 1e-4);
}

TEST_F(ExternalLoopsTest, OfAStandingCameraComesWithItsFrame) {
  add_frames(0, 21);
  ask(25.0, 4.0);
  for (std::int64_t id = 21; id < 25; ++id) {
    add_frame(id);
    EXPECT_TRUE(loops_.take().empty()) << id;
  }
  add_frame(25);
  const std::vector<core::LoopClosure> loops = loops_.take();
  ASSERT_EQ(loops.size(), 1U) << "before the next keyframe";
  EXPECT_EQ(loops[0].query_keyframe_id, 2);
  expect_loop(loops[0], 25.0, 4.0);
}

TEST_F(ExternalLoopsTest, NothingIsKnownOfAnImageInABreak) {
  add_frames(0, 25);
  ask(24.0, 4.0);
  ask(24.5, 4.0);
  EXPECT_EQ(loops_.take().size(), 1U) << "of the newest frame; the other waits";
  add_frame(25, core::SE3(core::so3_exp(core::Vec3(0.0, 1.0, 0.0)), core::Vec3(5.0, 0.0, 0.0)));
  add_frames(26, 30);
  ask(26.0, 4.0);
  ask(24.0, 4.0);
  const std::vector<core::LoopClosure> loops = loops_.take();
  EXPECT_TRUE(is_refused_as("lies in a break of the odometry"));
  ASSERT_EQ(loops.size(), 2U);
  EXPECT_EQ(loops[0].query_frame, 25) << "the keyframe after it";
  expect_loop(loops[0], 26.0, 4.0);
  EXPECT_EQ(loops[1].query_frame, 20);
  expect_loop(loops[1], 24.0, 4.0);
}

TEST_F(ExternalLoopsTest, WhatStillWaitsAtTheEndIsRefused) {
  add_frames(0, 41);
  ask(45.0, 4.0);
  EXPECT_TRUE(loops_.take().empty());
  EXPECT_TRUE(refusals_.empty());
  add_end();
  EXPECT_TRUE(is_refused_as("the session has ended"));
  ask(35.0, 4.0);
  EXPECT_TRUE(loops_.take().empty()) << "of the session before";
}

TEST_F(ExternalLoopsTest, OfAnotherClockAreRefusedOneByOne) {
  add_frames(0, 41);
  ask(35.0, -1.0);
  EXPECT_TRUE(loops_.take().empty());
  EXPECT_TRUE(is_refused_as("no keyframe that is so old"));
  refusals_.clear();
  for (int i = 0; i <= 100; ++i) ask(1000.0 + i, 4.0);
  EXPECT_TRUE(loops_.take().empty());
  EXPECT_EQ(refusals_.size(), 101U);
}

}  // namespace
}  // namespace semantic_topo_loop
