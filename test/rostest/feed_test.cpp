#include <gtest/gtest.h>
#include <rosbag/bag.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>

#include <cmath>
#include <limits>

#include "ros/conversions.h"
#include "ros/detection_watch.h"
#include "ros/frame_joiner.h"
#include "ros/image_watch.h"
#include "ros/playback.h"
#include "ros/pose_source.h"
#include "ros/stage.h"
#include "ros/tum_bag.h"
#include "support/test_files.h"

namespace semantic_topo_loop {
namespace {

constexpr std::int64_t kStart_ns = 1311868164363181000;
std::int64_t at_ms(std::int64_t milliseconds) { return kStart_ns + milliseconds * 1000000; }

geometry_msgs::TransformStamped transform(const std::string& parent, const std::string& child, std::int64_t stamp_ns,
                                          double x) {
  geometry_msgs::TransformStamped message;
  message.header = make_header(to_ros_time(stamp_ns), parent);
  message.child_frame_id = child;
  message.transform.translation.x = x;
  message.transform.rotation.w = 1.0;
  return message;
}

tf2_msgs::TFMessage message_of(const geometry_msgs::TransformStamped& transform) {
  tf2_msgs::TFMessage message;
  message.transforms.push_back(transform);
  return message;
}

/// odom -> base moves by 1 m/s, sampled at the given times; base -> camera is fixed, 2 m ahead.
void fill(TfPoses* poses, std::initializer_list<int> times_ms) {
  ASSERT_TRUE(poses->add(message_of(transform("/base", "/camera", 0, 2.0)), true));
  for (const int time_ms : times_ms) {
    const double x = 1e-3 * time_ms;
    ASSERT_TRUE(poses->add(message_of(transform("/odom", "/base", at_ms(time_ms), x)), false));
  }
}

TEST(TfPoses, ComposesTheChainAtTheStamp) {
  TfPoses poses("odom", 0.1);
  fill(&poses, {0, 50, 100});
  const PoseSource::Answer answer = poses.at(at_ms(60), "camera");
  ASSERT_EQ(answer.status, PoseSource::Status::kFound) << answer.problem;
  EXPECT_NEAR(answer.sample.T_odom_camera.t.x(), 2.06, 1e-9);
  EXPECT_EQ(answer.sample.stamp_ns, at_ms(60));
}

/// A quarter turn about z.
geometry_msgs::TransformStamped turned(geometry_msgs::TransformStamped transform) {
  transform.transform.rotation.z = transform.transform.rotation.w = std::sqrt(0.5);
  return transform;
}

TEST(TfPoses, TheMountTurnsWithTheBase) {
  TfPoses poses("odom", 0.1);
  ASSERT_TRUE(poses.add(message_of(transform("base", "camera", 0, 2.0)), true));
  for (const int time_ms : {0, 50}) {
    ASSERT_TRUE(poses.add(message_of(turned(transform("odom", "base", at_ms(time_ms), 1.0))), false));
  }
  EXPECT_LT((poses.at(at_ms(25), "camera").sample.T_odom_camera.t - core::Vec3(1.0, 2.0, 0.0)).norm(), 1e-9);
}

TEST(TfPoses, NeitherExtrapolatesNorBridgesGaps) {
  TfPoses poses("odom", 0.1);
  fill(&poses, {0, 50, 300});
  EXPECT_EQ(poses.at(at_ms(301), "camera").status, PoseSource::Status::kNotYet);
  const PoseSource::Answer gap = poses.at(at_ms(100), "camera");
  EXPECT_EQ(gap.status, PoseSource::Status::kNever);
  EXPECT_NE(gap.problem.find("odom -> base"), std::string::npos) << gap.problem;
  EXPECT_EQ(poses.at(at_ms(-1), "camera").status, PoseSource::Status::kNever);
}

TEST(TfPoses, SaysWhatIsMissing) {
  TfPoses poses("odom", 0.1);
  fill(&poses, {0, 50});
  const PoseSource::Answer answer = poses.at(at_ms(25), "lens");
  EXPECT_EQ(answer.status, PoseSource::Status::kNotYet);
  EXPECT_NE(answer.problem.find("'odom' down to 'lens'"), std::string::npos) << answer.problem;
}

TEST(TfPoses, LeavesBadTransformsOut) {
  TfPoses poses("odom", 0.1);
  fill(&poses, {0, 50});
  auto bad = transform("odom", "base", at_ms(100), std::numeric_limits<double>::quiet_NaN());
  std::string error = poses.add(message_of(bad), false).message();
  EXPECT_NE(error.find("odom -> base"), std::string::npos) << error;
  EXPECT_NE(error.find("nan"), std::string::npos) << error;
  bad = transform("odom", "base", at_ms(100), 0.1);
  bad.transform.rotation.w = 2.0;
  error = poses.add(message_of(bad), false).message();
  EXPECT_NE(error.find("norm"), std::string::npos) << error;
  EXPECT_EQ(poses.at(at_ms(75), "camera").status, PoseSource::Status::kNotYet);
  EXPECT_TRUE(poses.add(message_of(transform("odom", "base", at_ms(50), 0.05)), false)) << "a repeated one";
}

TEST(TfPoses, FollowsTimeThatJumpsBack) {
  TfPoses poses("odom", 0.1);
  fill(&poses, {10000, 10050});
  fill(&poses, {0, 50});
  EXPECT_EQ(poses.at(at_ms(25), "camera").status, PoseSource::Status::kFound);
  EXPECT_EQ(poses.at(at_ms(10025), "camera").status, PoseSource::Status::kNotYet);
}

TEST(TfPoses, ALateSampleOfAnotherFrameCostsNothing) {
  TfPoses poses("odom", 0.1);
  fill(&poses, {10000, 10050});
  ASSERT_EQ(poses.at(at_ms(10025), "camera").status, PoseSource::Status::kFound);
  // A wheel that nobody asked for, then what lies above the odometry.
  for (const char* child : {"wheel", "odom"}) {
    const std::string parent = child == std::string("wheel") ? "base" : "map";
    ASSERT_TRUE(poses.add(message_of(transform(parent, child, at_ms(10050), 0.1)), false));
    ASSERT_TRUE(poses.add(message_of(transform(parent, child, at_ms(8000), 0.1)), false));
    EXPECT_EQ(poses.at(at_ms(10025), "camera").status, PoseSource::Status::kFound) << child;
  }
  ASSERT_TRUE(poses.add(message_of(transform("odom", "base", at_ms(8000), 8.0)), false));
  EXPECT_EQ(poses.at(at_ms(10025), "camera").status, PoseSource::Status::kNotYet) << "the base itself jumped back";
}

nav_msgs::Odometry odometry_at(int time_ms) {
  nav_msgs::Odometry message;
  message.header = make_header(to_ros_time(at_ms(time_ms)), "odom");
  message.child_frame_id = "base";
  message.pose.pose.position.x = 1e-3 * time_ms;
  message.pose.pose.orientation.w = 1.0;
  return message;
}

TEST(OdometryPoses, MovesThePoseToTheCamera) {
  const auto transforms = std::make_shared<TfPoses>("odom", 0.1);
  OdometryPoses poses(transforms, 0.1);
  ASSERT_TRUE(poses.add(odometry_at(0)));
  ASSERT_TRUE(poses.add(odometry_at(50)));
  EXPECT_EQ(poses.at(at_ms(25), "camera").status, PoseSource::Status::kNotYet) << "no extrinsics yet";
  ASSERT_TRUE(transforms->add(message_of(transform("base", "camera", 0, 2.0)), true));
  const PoseSource::Answer answer = poses.at(at_ms(25), "camera");
  ASSERT_EQ(answer.status, PoseSource::Status::kFound) << answer.problem;
  EXPECT_NEAR(answer.sample.T_odom_camera.t.x(), 2.025, 1e-9);
  EXPECT_FALSE(answer.sample.covariance) << "the source states none";
  EXPECT_EQ(poses.at(at_ms(25), "base").status, PoseSource::Status::kFound) << "the odometry is the camera's";
}

TEST(OdometryPoses, AFrameThatDoesNotMoveInItselfIsNone) {
  const auto transforms = std::make_shared<TfPoses>("odom", 0.1);
  ASSERT_TRUE(transforms->add(message_of(transform("base", "camera", 0, 2.0)), true));
  ASSERT_TRUE(transforms->add(message_of(transform("world", "base", 0, 1.0)), false));
  const auto x_of = [&](const std::string& child, const std::string& base_frame) {
    OdometryPoses poses(transforms, 0.1, base_frame);
    nav_msgs::Odometry message = odometry_at(0);
    message.header.frame_id = "/world";
    message.child_frame_id = child;
    const core::Status added = poses.add(message);
    if (!added) return added.message();
    return std::to_string(poses.at(at_ms(0), "camera").sample.T_odom_camera.t.x());
  };
  EXPECT_EQ(x_of("world", ""),
            "odometry child_frame_id = 'world' is its header's frame_id; base_frame can name the frame that moves");
  EXPECT_EQ(x_of("world", "base"), std::to_string(2.0));
  EXPECT_EQ(x_of("", "base"), std::to_string(2.0));
  EXPECT_EQ(x_of("", ""), std::to_string(0.0)) << "the camera's own";
  EXPECT_EQ(x_of("base", "other"), std::to_string(2.0));
}

TEST(OdometryPoses, TakesTheStepsCovarianceFromTheTwist) {
  OdometryPoses poses(std::make_shared<TfPoses>("odom", 1.0), 1.0);
  for (const int time_ms : {0, 500, 1000}) {
    nav_msgs::Odometry message = odometry_at(time_ms);
    for (std::size_t i = 0; i < 36; i += 7) message.twist.covariance[i] = 0.04;
    ASSERT_TRUE(poses.add(message));
  }
  EXPECT_FALSE(poses.at(at_ms(100), "base").sample.covariance) << "the first pose has no predecessor";
  poses.use(at_ms(100));
  EXPECT_TRUE(poses.at(at_ms(600), "base").sample.covariance) << "asked for, and asked for again when its cloud came";
  const PoseSource::Answer answer = poses.at(at_ms(600), "base");
  ASSERT_TRUE(answer.sample.covariance);
  EXPECT_LT((*answer.sample.covariance - 0.01 * core::Mat6::Identity()).norm(), 1e-12) << "(0.2 m/s * 0.5 s)^2";
  const auto variance_of = [&poses](int step_ms) {
    return (*poses.at(at_ms(100 + step_ms), "base").sample.covariance)(0, 0);
  };
  EXPECT_NEAR(50.0 * variance_of(20), 20.0 * variance_of(50), 1e-12) << "of a second, at 50 and at 20 images a second";
  poses.reset();
  EXPECT_FALSE(poses.at(at_ms(700), "base").sample.covariance);
}

TEST(OdometryPoses, ARobotThatStandsBecomesHardlyMoreUncertain) {
  OdometryPoses poses(std::make_shared<TfPoses>("odom", 1.0), 1.0);
  for (int time_ms = 0; time_ms <= 2000; time_ms += 50) {
    nav_msgs::Odometry message = odometry_at(std::min(time_ms, 1000));
    message.header = make_header(to_ros_time(at_ms(time_ms)), "odom");
    for (std::size_t i = 0; i < 36; i += 7) message.twist.covariance[i] = 0.04;
    ASSERT_TRUE(poses.add(message));
  }
  const auto sigma_from = [&poses](int begin_ms) {
    poses.use(at_ms(begin_ms));
    return std::sqrt((*poses.at(at_ms(begin_ms + 33), "base").sample.covariance)(0, 0));
  };
  EXPECT_NEAR(sigma_from(1510), 0.01 * sigma_from(510), 1e-9);
}

TEST(OdometryPoses, ACovarianceThatIsNoLongerStatedIsNone) {
  OdometryPoses poses(std::make_shared<TfPoses>("odom", 0.1), 0.1);
  for (int time_ms = 0; time_ms <= 2000; time_ms += 50) {
    nav_msgs::Odometry message = odometry_at(time_ms);
    for (std::size_t i = 0; i < 36; i += 7) message.twist.covariance[i] = time_ms <= 500 ? 0.04 : 9999.0;
    ASSERT_TRUE(poses.add(message));
  }
  poses.use(at_ms(450));
  EXPECT_TRUE(poses.at(at_ms(510), "base").sample.covariance);
  EXPECT_FALSE(poses.at(at_ms(560), "base").sample.covariance);
}

/// Images may pause, or be few; the way of the robot is known.
TEST(OdometryPoses, VouchForTheWayThatTheyHaveNoGapIn) {
  for (const bool has_gap : {false, true}) {
    const auto transforms = std::make_shared<TfPoses>("odom", 0.1);
    OdometryPoses poses(std::make_shared<TfPoses>("odom", 0.1), 0.1);
    for (int time_ms = 0; time_ms <= 5000; time_ms += 50) {
      if (has_gap && time_ms > 2000 && time_ms < 4000) continue;
      fill(transforms.get(), {time_ms});
      ASSERT_TRUE(poses.add(odometry_at(time_ms)));
    }
    EXPECT_FALSE(transforms->at(at_ms(110), "camera").sample.is_continuous) << "the first";
    EXPECT_FALSE(poses.at(at_ms(110), "base").sample.is_continuous) << "the first";
    transforms->use(at_ms(110));
    poses.use(at_ms(110));
    EXPECT_EQ(transforms->at(at_ms(4110), "camera").sample.is_continuous, !has_gap);
    EXPECT_EQ(poses.at(at_ms(4110), "base").sample.is_continuous, !has_gap);
    transforms->reset();
    EXPECT_FALSE(transforms->at(at_ms(4110), "camera").sample.is_continuous) << "the first of a session";
  }
}

TEST(OdometryPoses, CarriesTheCovarianceToTheCamera) {
  const auto transforms = std::make_shared<TfPoses>("odom", 1.0);
  ASSERT_TRUE(transforms->add(message_of(turned(transform("base", "camera", 0, 2.0))), true));
  OdometryPoses poses(transforms, 1.0);
  for (const int time_ms : {0, 500, 1000}) {
    nav_msgs::Odometry message = odometry_at(time_ms);
    for (std::size_t i = 0; i < 36; i += 7) message.twist.covariance[i] = 1e-9;
    message.twist.covariance[35] = 0.04;  // of the yaw rate
    ASSERT_TRUE(poses.add(message));
  }
  poses.use(at_ms(100));
  const PoseSource::Answer answer = poses.at(at_ms(600), "camera");
  ASSERT_TRUE(answer.sample.covariance);
  // 2 m ahead of the base it moves to the base's left, which is where the camera's x points.
  EXPECT_NEAR((*answer.sample.covariance)(0, 0), 0.04, 1e-6) << "(2 m * 0.2 rad/s * 0.5 s)^2";
  EXPECT_NEAR((*answer.sample.covariance)(1, 1), 0.0, 1e-6);
  EXPECT_NEAR((*answer.sample.covariance)(5, 5), 0.01, 1e-6);
}

TEST(OdometryPoses, FollowsTimeThatJumpsBack) {
  OdometryPoses poses(std::make_shared<TfPoses>("odom", 0.1), 0.1);
  for (const int time_ms : {10000, 10050, 0, 50}) ASSERT_TRUE(poses.add(odometry_at(time_ms)));
  EXPECT_EQ(poses.at(at_ms(25), "base").status, PoseSource::Status::kFound);
  EXPECT_EQ(poses.at(at_ms(10025), "base").status, PoseSource::Status::kNotYet);
}

TEST(OdometryPoses, LeavesBadMessagesOut) {
  OdometryPoses poses(std::make_shared<TfPoses>("odom", 0.1), 0.1);
  nav_msgs::Odometry bad = odometry_at(0);
  bad.pose.pose.orientation.w = 0.0;
  std::string error = poses.add(bad).message();
  EXPECT_NE(error.find("odometry pose.orientation"), std::string::npos) << error;
  bad = odometry_at(0);
  bad.pose.pose.position.z = std::numeric_limits<double>::infinity();
  error = poses.add(bad).message();
  EXPECT_NE(error.find("position.z"), std::string::npos) << error;
}

TEST(FilePoses, KnowsItsOwnStampsOnly) {
  FilePoses poses({{at_ms(0), core::SE3()}, {at_ms(33), core::SE3()}});
  EXPECT_EQ(poses.at(at_ms(33) + 900, "camera").status, PoseSource::Status::kFound);
  const PoseSource::Answer answer = poses.at(at_ms(33) + 1100, "camera");
  EXPECT_EQ(answer.status, PoseSource::Status::kNever);
  EXPECT_NE(answer.problem.find("1311868164.396"), std::string::npos) << answer.problem;
}

TEST(DetectionMatcher, JoinsWithinAMicrosecondAndCountsTheRest) {
  DetectionMatcher matcher(10);
  for (const int time_ms : {0, 33, 66, 99}) matcher.add({at_ms(time_ms), {}});
  EXPECT_FALSE(matcher.take(at_ms(33) + 2000));
  EXPECT_TRUE(matcher.take(at_ms(66) - 1000));
  matcher.forget_before(at_ms(66) - 1000);
  EXPECT_EQ(matcher.unmatched(), 2u) << "those before";
  EXPECT_FALSE(matcher.take(at_ms(66))) << "given out already";
  EXPECT_TRUE(matcher.take(at_ms(99)));
}

TEST(DetectionMatcher, IsBoundedAndFollowsTimeThatJumpsBack) {
  DetectionMatcher matcher(3);
  for (const int time_ms : {5000, 5033, 5066, 5099}) matcher.add({at_ms(time_ms), {}});
  EXPECT_EQ(matcher.unmatched(), 1u);
  matcher.add({at_ms(0), {}});
  EXPECT_EQ(matcher.unmatched(), 4u);
  EXPECT_TRUE(matcher.take(at_ms(0)));
}

TEST(DetectionMatcher, ALaterAnswerSaysThatNoneWillCome) {
  DetectionMatcher matcher(10);
  matcher.add({at_ms(5099), {}});
  EXPECT_TRUE(matcher.is_past(at_ms(5066)));
  EXPECT_FALSE(matcher.is_past(at_ms(5099) - 1000)) << "it is there";
  EXPECT_FALSE(matcher.is_past(at_ms(5132)));
  EXPECT_FALSE(matcher.is_past(at_ms(0))) << "of another time";
}

class WatchedDetections : public ::testing::Test {
 protected:
  /// @param frame_ms, detections_ms what comes each 100 ms for so long, stamped from there on; negative: nothing
  void run(double seconds, int frame_ms, int detections_ms, bool meet = false) {
    for (int i = 0; i < static_cast<int>(10.0 * seconds); ++i, now_ += std::chrono::milliseconds(100)) {
      if (frame_ms >= 0) watch_.hear_frame(at_ms(frame_ms + 100 * i), now_);
      if (detections_ms >= 0) watch_.hear_detections(at_ms(detections_ms + 100 * i), now_);
      if (meet) watch_.meet();
    }
  }
  void expect(const std::string& begin, const std::string& end) const {
    const std::string text = watch_.starvation(now_);
    EXPECT_EQ(text.find(begin), 0u) << text;
    EXPECT_EQ(text.substr(text.size() - std::min(text.size(), end.size())), end);
  }

  DetectionWatch watch_{"/frames", "/boxes"};
  DetectionWatch::Clock::time_point now_ = DetectionWatch::Clock::now();
};

TEST_F(WatchedDetections, FramesWithoutDetections) {
  expect("", "");
  run(2.9, 0, -1);
  EXPECT_EQ(watch_.starvation(now_), "");
  run(0.5, 2900, -1);
  expect("frames on '/frames', but no detections on '/boxes'; '/frames': last stamp 1311868167.66",
         "'/boxes': nothing yet");
  run(0.1, 3400, 3400, true);
  EXPECT_EQ(watch_.starvation(now_), "");
}

TEST_F(WatchedDetections, DetectionsWithoutFrames) {
  run(4.0, 0, 0, true);
  run(4.0, -1, 4000);
  expect("detections on '/boxes', but no frames on '/frames'; ", "; gap 4.000000 s");
}

TEST_F(WatchedDetections, StampsThatAreNeverTheSame) {
  run(4.0, 0, 12);
  expect("frames on '/frames' and detections on '/boxes', but none with the stamp of the other", "; gap 0.012000 s");
}

TEST_F(WatchedDetections, StampsThatAreNeverTheSameWhenTheFrameComesLater) {
  for (int i = 0; watch_.starvation(now_).empty() && i < 100; ++i) {
    watch_.hear_detections(at_ms(50 * i), now_);
    now_ += std::chrono::milliseconds(20);
    EXPECT_EQ(watch_.starvation(now_).find("detections on '/boxes', but no frames"), std::string::npos);
    watch_.hear_frame(at_ms(50 * i + 5), now_);
    now_ += std::chrono::milliseconds(30);
  }
  expect("frames on '/frames' and detections on '/boxes', but none with the stamp of the other", "; gap -0.005000 s");
}

TEST_F(WatchedDetections, SilenceOfBothIsNoStarvation) {
  run(2.0, 0, -1);
  now_ += std::chrono::seconds(60);
  EXPECT_EQ(watch_.starvation(now_), "");
  run(2.0, 62000, -1);
  EXPECT_EQ(watch_.starvation(now_), "") << "detections may come yet";
}

TEST_F(WatchedDetections, ASlowDetectorIsNone) {
  for (int i = 0; i < 5; ++i) {
    run(2.0, 2000 * i, -1);
    run(0.1, 2000 * i, 2000 * i, true);
    EXPECT_EQ(watch_.starvation(now_), "");
  }
}

TEST_F(WatchedDetections, AnswersThatNobodyWaitsForAnyMore) {
  for (int i = 0; i < 3; ++i) {  // 1.3 s an image; only those that were left out meanwhile meet their frames
    EXPECT_EQ(watch_.starvation(now_), "");
    run(1.3, 1300 * i, -1);
    watch_.hear_detections(at_ms(1300 * i), now_);
    watch_.meet_unanswered();
  }
  run(0.5, 3900, -1);
  expect("frames on '/frames' and detections on '/boxes', but none with the stamp of the other", "; gap -1.700000 s");
}

TEST(ImageWatch, NamesTheTopicThatIsSilent) {
  ImageWatch watch;
  for (int i = 0; i < 4; ++i) EXPECT_EQ(watch.tick("/info"), "");
  EXPECT_EQ(watch.tick("/info"), "no image for 5 s: nothing on '/info'");
  watch.hear_image();
  EXPECT_EQ(watch.tick("/info"), "");
  for (int i = 0; i < 20; ++i) EXPECT_EQ(watch.tick(""), "") << "none is awaited";
  EXPECT_EQ(watch.tick("/info"), "") << "and one only from now on";
}

TEST(ImageWatch, TellsWhyImagesGiveNoFrame) {
  ImageWatch watch;
  const auto see = [&watch](const std::string& failure) {
    watch.hear_image();
    if (failure.empty()) watch.hear_frame();
    if (!failure.empty()) watch.hear_failure(failure);
    return watch.tick("/info");
  };
  for (int i = 0; i < 4; ++i) EXPECT_EQ(see("no pose"), "");
  EXPECT_EQ(see("no tf"), "images, but no frame for 5 s: no tf");
  EXPECT_EQ(see(""), "");
  for (int i = 0; i < 4; ++i) EXPECT_EQ(see("no pose"), "") << "it counts anew";
  EXPECT_EQ(watch.tick(""), "") << "no image, no verdict";
  EXPECT_EQ(see("no pose"), "images, but no frame for 5 s: no pose");
  for (int i = 0; i < 5; ++i) watch.tick("/info");
  EXPECT_EQ(see("no pose"), "") << "silence was told in place of it";
}

SessionControl start_of(std::uint32_t session_id) {
  SessionControl control;
  control.header.stamp = ros::Time(session_id, 0);
  control.session_id = session_id;
  control.command = SessionControl::COMMAND_START;
  return control;
}

SessionAck ack_of(const std::string& stage, std::uint32_t session_id) {
  SessionAck ack;
  ack.stage = stage;
  ack.session_id = session_id;
  return ack;
}

FrameDone done_of(int time_ms, std::uint8_t status) {
  FrameDone done;
  done.header.stamp = to_ros_time(at_ms(time_ms));
  done.session_id = 1;
  done.status = status;
  return done;
}

TEST(PlayerLedger, NamesTheStagesThatAreNotUp) {
  PlayerLedger ledger("PoseFrontend", {"DetectionIngestion", "PoseGraph"}, false);
  EXPECT_EQ(ledger.missing_stages(), std::vector<std::string>{"PoseFrontend"});
  ledger.take(ack_of("PoseGraph", 1));
  ledger.take(start_of(1));
  EXPECT_EQ(ledger.missing_stages(), std::vector<std::string>{"DetectionIngestion"});
  ledger.take(ack_of("DetectionIngestion", 1));
  EXPECT_TRUE(ledger.missing_stages().empty());
  ledger.take(start_of(2));
  EXPECT_EQ(ledger.missing_stages().size(), 2u) << "a new session must be acknowledged anew";
}

TEST(PlayerLedger, WaitsWhilePausedWhateverElseIsSaid) {
  PlayerLedger ledger("PoseFrontend", {}, false);
  SessionControl control = start_of(1);
  ledger.take(control);
  control.command = SessionControl::COMMAND_PAUSE;
  ledger.take(control);
  control.command = SessionControl::COMMAND_LOCALIZATION;
  ledger.take(control);
  EXPECT_TRUE(ledger.is_paused());
  control.command = SessionControl::COMMAND_RESUME;
  ledger.take(control);
  EXPECT_FALSE(ledger.is_paused());
}

TEST(PlayerLedger, GivesCreditBackOnceAFrameIsDone) {
  PlayerLedger ledger("PoseFrontend", {}, false);
  ledger.take(start_of(1));
  for (const int time_ms : {0, 33, 66}) ledger.sent(at_ms(time_ms));
  ledger.numbered(1, at_ms(0), 0, false);
  ledger.done(done_of(33, FrameDone::STATUS_NO_POSE));
  EXPECT_EQ(ledger.in_flight(), 2u);
  EXPECT_EQ(ledger.frames_without_pose(), 1u);
  ledger.done(done_of(66, FrameDone::STATUS_PROCESSED));
  EXPECT_EQ(ledger.in_flight(), 0u) << "a processed frame answers for older ones, which were dropped";
  ledger.done(done_of(50, FrameDone::STATUS_FAILED));
  EXPECT_EQ(ledger.frames_done(), 2u) << "not of an image that is not on its way, as one from before a rewind";
  ledger.sent(at_ms(99));
  ledger.take(start_of(1));
  EXPECT_EQ(ledger.in_flight(), 1u) << "the session was only repeated";
  ledger.take(start_of(2));
  EXPECT_EQ(ledger.in_flight(), 0u) << "the stages have forgotten it";
}

TEST(PlayerLedger, AnImageWithoutAPoseAnswersThoseThatTheFrontEndDropped) {
  PlayerLedger ledger("RgbdFrontend", {}, false);
  ledger.take(start_of(1));
  for (const int time_ms : {0, 33, 66, 99, 132}) ledger.sent(at_ms(time_ms));
  ledger.numbered(1, at_ms(33), 0, false);
  EXPECT_EQ(ledger.silent_stage(), "DetectionIngestion") << "the image before that frame was dropped";
  ledger.done(done_of(99, FrameDone::STATUS_FAILED));
  EXPECT_EQ(ledger.in_flight(), 4u) << "what is refused may be so out of turn";
  ledger.done(done_of(132, FrameDone::STATUS_NO_POSE));
  EXPECT_EQ(ledger.in_flight(), 1u) << "the frame is still in the chain";
  EXPECT_EQ(ledger.frames_done(), 2u);
  ledger.done(done_of(33, FrameDone::STATUS_PROCESSED));
  EXPECT_EQ(ledger.in_flight(), 0u);
}

TEST(PlayerLedger, NamesTheFirstStageThatHasNotShownTheFrame) {
  PlayerLedger ledger("PoseFrontend", {}, true);
  ledger.take(start_of(1));
  ledger.sent(at_ms(0));
  EXPECT_EQ(ledger.silent_stage(), "PoseFrontend");
  ledger.numbered(1, at_ms(0), 0, false);
  EXPECT_EQ(ledger.silent_stage(), "DetectionIngestion");
  ledger.seen(PlayerLedger::kDetections, 1, 0);
  ledger.seen(PlayerLedger::kAssociations, 2, 0);
  EXPECT_EQ(ledger.silent_stage(), "ObjectAssociation") << "another session does not count";
  ledger.seen(PlayerLedger::kAssociations, 1, 0);
  ledger.seen(PlayerLedger::kObservations, 1, 0);
  EXPECT_EQ(ledger.silent_stage(), "LoopDetection");
  ledger.seen(PlayerLedger::kLoopClosures, 1, 0);
  ledger.seen(PlayerLedger::kCorrections, 1, 0);
  EXPECT_EQ(ledger.silent_stage(), "QuadricMapping");
  ledger.seen(PlayerLedger::kCompletions, 1, 0);
  EXPECT_EQ(ledger.silent_stage(), "ObjectAssociation");
  ledger.done(done_of(0, FrameDone::STATUS_PROCESSED));

  ledger.end_sent();
  EXPECT_EQ(ledger.silent_stage(), "PoseFrontend");
  ledger.numbered(1, at_ms(0), 1, true);
  EXPECT_EQ(ledger.silent_stage(), "DetectionIngestion");
  ledger.done(done_of(0, FrameDone::STATUS_END));
  EXPECT_FALSE(ledger.is_end_done());
  EXPECT_EQ(ledger.silent_stage(), "Recorder");
  ledger.results_written();
  EXPECT_TRUE(ledger.is_end_done());
}

/// A bag as the TUM ones, with an image each 100 ms and the motion capture each 20 ms.
std::string write_bag(const core::TestDirectory& directory, int duration_ms,
                      rosbag::CompressionType compression = rosbag::compression::BZ2) {
  const std::string file = directory.path("recording.bag");
  rosbag::Bag bag(file, rosbag::bagmode::Write);
  bag.setCompression(compression);
  bag.setChunkThreshold(4096);
  for (int time_ms = 0; time_ms <= duration_ms; time_ms += 20) {
    const ros::Time time = to_ros_time(at_ms(time_ms));
    bag.write("/tf", time, message_of(transform("/world", "/kinect", at_ms(time_ms), 1e-3 * time_ms)));
    bag.write("/tf", time, message_of(transform("/kinect", "/openni_camera", at_ms(time_ms), 0.0)));
    if (time_ms % 100 != 0) continue;
    sensor_msgs::CameraInfo camera_info;
    camera_info.header = make_header(time, "/openni_rgb_optical_frame");
    camera_info.K[0] = camera_info.K[4] = 525.0;
    bag.write("/camera/rgb/camera_info", time, camera_info);
    sensor_msgs::Image image;
    image.header = camera_info.header;
    image.data.resize(1000);
    bag.write("/camera/rgb/image_color", time, image);
  }
  return file;
}

TumBagPlayback playback_of(const std::string& file) {
  TumBagPlayback playback;
  playback.file = file;
  return playback;
}

TEST(TumBagSource, GivesTransformsAheadOfTheImages) {
  const core::TestDirectory directory;
  TumBagPlayback playback = playback_of(write_bag(directory, 2000));
  playback.mocap_tf = "odom";
  const auto opened = TumBagSource::open(playback, std::nullopt);
  ASSERT_TRUE(opened) << opened.message();
  const auto& source = *opened;
  EXPECT_EQ(source->size(), 21u);
  std::int64_t newest_ns = 0;
  int images = 0;
  while (const std::optional<PlayerItem> item = source->next()) {
    for (const tf2_msgs::TFMessage& message : item->transforms) {
      for (const geometry_msgs::TransformStamped& t : message.transforms) {
        newest_ns = std::max(newest_ns, to_stamp_ns(t.header.stamp));
        EXPECT_EQ(t.header.frame_id, t.child_frame_id == "kinect" ? "odom" : "kinect");
      }
    }
    const std::int64_t stamp_ns = to_stamp_ns(item->camera_info.header.stamp);
    EXPECT_EQ(stamp_ns, at_ms(100 * images));
    EXPECT_GE(newest_ns, std::min(stamp_ns + 300000000, at_ms(2000)));
    EXPECT_EQ(item->camera_info.header.frame_id, "openni_rgb_optical_frame");
    EXPECT_EQ(item->camera_info.K[0], 525.0);
    ++images;
  }
  EXPECT_TRUE(source->end()) << source->end().message();
  EXPECT_EQ(images, 21);
}

TEST(TumBagSource, DropsTheMotionCaptureAndReplacesTheCalibration) {
  const core::TestDirectory directory;
  TumBagPlayback playback = playback_of(write_bag(directory, 500));
  playback.stamps = "camera_info";
  sensor_msgs::CameraInfo calibration;
  calibration.K[0] = 520.9;
  const auto opened = TumBagSource::open(playback, calibration);
  ASSERT_TRUE(opened) << opened.message();
  const auto& source = *opened;
  int images = 0, transforms = 0;
  while (const std::optional<PlayerItem> item = source->next()) {
    ++images;
    EXPECT_EQ(item->camera_info.K[0], 520.9);
    for (const tf2_msgs::TFMessage& message : item->transforms) {
      for (const geometry_msgs::TransformStamped& t : message.transforms) {
        ++transforms;
        EXPECT_EQ(t.child_frame_id, "openni_camera");
      }
    }
  }
  EXPECT_EQ(images, 6);
  EXPECT_EQ(transforms, 26);
}

TEST(TumBagSource, GivesWhatNeverMovesWithTheFirstImage) {
  const core::TestDirectory directory;
  const std::string file = write_bag(directory, 500);
  {
    rosbag::Bag bag(file, rosbag::bagmode::Append);
    bag.write("/tf_static", to_ros_time(at_ms(0)), message_of(transform("/camera_link", "/lens", 0, 0.1)));
  }
  const auto opened = TumBagSource::open(playback_of(file), std::nullopt);
  ASSERT_TRUE(opened) << opened.message();
  const std::optional<PlayerItem> first = (*opened)->next();
  ASSERT_TRUE(first);
  ASSERT_EQ(first->static_transforms.size(), 1u);
  EXPECT_EQ(first->static_transforms[0].header.frame_id, "camera_link");
  EXPECT_EQ(first->static_transforms[0].child_frame_id, "lens");
  const std::optional<PlayerItem> second = (*opened)->next();
  ASSERT_TRUE(second);
  EXPECT_TRUE(second->static_transforms.empty());
}

TEST(TumBagSource, SaysWhatIsWrongWithAFile) {
  const core::TestDirectory directory;
  const auto problem = [](const std::string& file) {
    return TumBagSource::open(playback_of(file), std::nullopt).message();
  };
  const auto expect_in = [](const std::string& part, const std::string& text) {
    EXPECT_NE(text.find(part), std::string::npos) << text;
  };
  expect_in("none.bag", problem(directory.path("none.bag")));
  expect_in("text.bag", problem(directory.write("text.bag", "no bag")));
  const std::string whole = core::read_whole(write_bag(directory, 2000));
  expect_in("cut.bag", problem(directory.write("cut.bag", whole.substr(0, whole.size() / 2))));
  const std::string other = directory.path("other.bag");
  rosbag::Bag(other, rosbag::bagmode::Write).write("/imu", ros::Time(1), message_of(transform("a", "b", 0, 0.0)));
  expect_in("/camera/rgb/image_color", problem(other));
  const std::string compressed = directory.path("compressed.bag");
  rosbag::Bag(compressed, rosbag::bagmode::Write)
      .write("/camera/rgb/image_color", ros::Time(1), sensor_msgs::CompressedImage());
  expect_in("holds sensor_msgs/CompressedImage on /camera/rgb/image_color, which must be sensor_msgs/Image",
            problem(compressed));
}

TEST(TumBagSource, NoChangedByteLeadsAstray) {
  const core::TestDirectory directory;
  for (const rosbag::CompressionType compression : {rosbag::compression::Uncompressed, rosbag::compression::BZ2}) {
    const std::string whole = core::read_whole(write_bag(directory, 200, compression));
    int refused = 0, read = 0;
    for (std::size_t i = 0; i < whole.size(); i += 11) {
      std::string bytes = whole;
      bytes[i] = '\xfe';
      const auto opened = TumBagSource::open(playback_of(directory.write("changed.bag", bytes)), std::nullopt);
      int images = 0;
      while (opened && (*opened)->next()) ++images;
      EXPECT_LE(images, 3) << "byte " << i;
      ++(opened ? read : refused);
    }
    EXPECT_GT(refused, 50);
    EXPECT_GT(read, 50) << "what lies in an image harms nothing";
  }
  std::string cut = core::read_whole(write_bag(directory, 200, rosbag::compression::Uncompressed));
  cut.resize(cut.size() - 10);
  const auto opened = TumBagSource::open(playback_of(directory.write("cut.bag", cut)), std::nullopt);
  EXPECT_NE(opened.message().find("cut.bag': is damaged or cut short, from byte "), std::string::npos)
      << opened.message();
}

TEST(TumBagSource, EndsWhereTheFileIsDamaged) {
  const core::TestDirectory directory;
  std::string bytes = core::read_whole(write_bag(directory, 4000));
  // Inside the data of a compressed chunk; the records around it tell where everything is.
  const std::size_t chunk = bytes.find("BZh", bytes.size() / 2);
  ASSERT_NE(chunk, std::string::npos);
  bytes.replace(chunk + 30, 20, 20, '\xff');
  const auto opened = TumBagSource::open(playback_of(directory.write("damaged.bag", bytes)), std::nullopt);
  ASSERT_TRUE(opened) << opened.message();
  const auto& source = *opened;
  int images = 0;
  while (source->next()) ++images;
  EXPECT_NE(source->end().message().find("damaged.bag"), std::string::npos) << source->end().message();
  EXPECT_GT(images, 3);
  EXPECT_LT(images, 41);
  EXPECT_FALSE(source->next()) << "and stays there";
}

}  // namespace
}  // namespace semantic_topo_loop
