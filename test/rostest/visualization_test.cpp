// What Visualization makes of what the stages say, while somebody looks.
#include <cv_bridge/cv_bridge.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/image_encodings.h>
#include <std_msgs/String.h>

#include <cmath>

#include "ros/conversions.h"
#include "ros/stage.h"
#include "semantic_topo_loop/Keyframe.h"
#include "semantic_topo_loop/LoopMap.h"
#include "semantic_topo_loop/SessionAck.h"
#include "semantic_topo_loop/SessionControl.h"
#include "semantic_topo_loop/ros/messages.h"
#include "support/in_process_chain.h"

namespace semantic_topo_loop {
namespace {

constexpr double kPatience_s = 20.0;
constexpr int kWidth = 320, kHeight = 240, kCup = 41;

/// Keeps the last message of a topic.
template <class Message>
class Last {
 public:
  explicit Last(const std::string& topic) { subscriber_ = node_.subscribe<Message>(topic, 100, &Last::take, this); }
  ~Last() { subscriber_.shutdown(); }

  /// @return the first one to come that suits; null if none does in time
  boost::shared_ptr<const Message> wait_for(const std::function<bool(const Message&)>& suits) {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait_for(lock, std::chrono::duration<double>(kPatience_s), [&] { return last_ && suits(*last_); });
    return last_ && suits(*last_) ? last_ : nullptr;
  }

 private:
  void take(const boost::shared_ptr<const Message>& message) {
    const std::lock_guard<std::mutex> lock(mutex_);
    last_ = message;
    changed_.notify_all();
  }

  ros::NodeHandle node_;
  ros::Subscriber subscriber_;
  std::mutex mutex_;  ///< guards last_
  std::condition_variable changed_;
  boost::shared_ptr<const Message> last_;
};

/// Plays the stages that Visualization listens to. One object, a sphere of 0.3 m 2 m before the first camera.
class Visualization : public ::testing::Test {
 protected:
  void SetUp() override {
    chain_.set("visualization", "rate_hz", 50.0);
    chain_.load("visualization", "Visualization");
    SessionControl start;
    start.session_id = 1;
    start.command = SessionControl::COMMAND_START;
    Last<SessionAck> ack("session_acks");
    control_.publish(start);
    ASSERT_TRUE(ack.wait_for([](const SessionAck& a) { return a.session_id == 1; }));
    ASSERT_TRUE(wait_until([this] {
      return updates_.getNumSubscribers() > 0 && keyframes_.getNumSubscribers() > 0 && loops_.getNumSubscribers() > 0 &&
             corrections_.getNumSubscribers() > 0;
    }));
    core::MapUpdate update;
    update.map_version = 1;
    core::Landmark& landmark = update.changed.emplace_back();
    landmark.id = 5;
    landmark.class_id = kCup;
    landmark.state = core::LandmarkState::kConfirmed;
    landmark.ellipsoid =
        core::Ellipsoid{core::SE3(core::Quaternion::Identity(), {0.0, 0.0, 2.0}), core::Vec3::Constant(0.3)};
    updates_.publish(boost::make_shared<MapUpdateMessage>(make_header(ros::Time(1.0), "map"), 1, update));
  }
  void TearDown() override { chain_.unload_all(); }

  void publish_frame(const ros::Time& stamp) {
    CameraFrame frame;
    frame.stamp_ns = to_stamp_ns(stamp);
    frame.frame_id = ++frame_id_;
    frame.camera = {250.0, 250.0, 160.0, 120.0, kWidth, kHeight, {}};
    frame.camera_frame = "camera";
    frames_.publish(boost::make_shared<FrameMessage>(make_header(stamp, "odom"), 1, frame));
    core::AssociationFrame associations;
    associations.frame_id = frame_id_;
    associations_.publish(boost::make_shared<AssociationsMessage>(make_header(stamp, "camera"), 1, associations));
  }
  void publish_image(const ros::Time& stamp) {
    const cv::Mat black(kHeight, kWidth, CV_8UC3, cv::Scalar::all(0.0));
    color_.publish(
        cv_bridge::CvImage(make_header(stamp, "camera"), sensor_msgs::image_encodings::RGB8, black).toImageMsg());
  }

  InProcessChain chain_;
  ros::NodeHandle node_;
  ros::Publisher control_ = node_.advertise<SessionControl>("session_control", 1, true);
  ros::Publisher updates_ = node_.advertise<MapUpdateMessage>("quadric_map_updates", 10);
  ros::Publisher keyframes_ = node_.advertise<Keyframe>("keyframes", 10);
  ros::Publisher loops_ = node_.advertise<LoopsMessage>("loop_closures", 10);
  ros::Publisher corrections_ = node_.advertise<CorrectionMessage>("map_corrections", 10);
  ros::Publisher frames_ = node_.advertise<FrameMessage>("frames", 10);
  ros::Publisher associations_ = node_.advertise<AssociationsMessage>("associations", 10);
  ros::Publisher color_ = node_.advertise<sensor_msgs::Image>("color", 10);
  std::int64_t frame_id_ = -1;
};

TEST_F(Visualization, DrawsIntoTheImageOfAFrameWhileSomebodyLooks) {
  EXPECT_EQ(color_.getNumSubscribers(), 0u) << "nobody looks";
  {
    Last<sensor_msgs::Image> annotated("annotated_image");
    ASSERT_TRUE(wait_until([this] {
      return color_.getNumSubscribers() > 0 && frames_.getNumSubscribers() > 0 && associations_.getNumSubscribers() > 0;
    }));
    // An image may come before its frame or after it.
    publish_image(ros::Time(10.0));
    publish_frame(ros::Time(10.0));
    ASSERT_TRUE(annotated.wait_for([](const auto& image) { return image.header.stamp == ros::Time(10.0); }));
    publish_frame(ros::Time(11.0));
    publish_image(ros::Time(11.0));
    const auto image = annotated.wait_for([](const auto& i) { return i.header.stamp == ros::Time(11.0); });
    ASSERT_TRUE(image);
    EXPECT_EQ(image->header.frame_id, "camera");
    const cv::Mat pixels = cv_bridge::toCvCopy(image, sensor_msgs::image_encodings::BGR8)->image;
    const double radius_px = 250.0 * 0.3 / std::sqrt(2.0 * 2.0 - 0.3 * 0.3);
    std::size_t drawn = 0;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        if (cv::norm(pixels.at<cv::Vec3b>(y, x)) < 60.0) continue;
        ++drawn;
        ASSERT_NEAR(std::hypot(x - 160.0, y - 120.0), radius_px, 2.0);
      }
    }
    EXPECT_GT(drawn, static_cast<std::size_t>(6.0 * radius_px));
  }
  EXPECT_TRUE(wait_until([this] { return color_.getNumSubscribers() == 0; })) << "nobody looks any longer";
}

TEST_F(Visualization, WhoComesLateHasEveryLoopAndItsMoves) {
  for (std::int64_t id : {0, 1}) {
    Keyframe keyframe;
    keyframe.session_id = 1;
    keyframe.keyframe_id = id;
    keyframe.odom_from_camera = to_msg(core::SE3(core::Quaternion::Identity(), {static_cast<double>(id), 0.0, 0.0}));
    keyframes_.publish(keyframe);
  }
  FrameLoops found;
  found.closures.resize(1);
  found.closures[0].query_keyframe_id = 1;
  found.closures[0].match_keyframe_id = 0;
  found.closures[0].accepted = true;
  found.closures[0].matches = {{5, 5}};
  loops_.publish(boost::make_shared<LoopsMessage>(std_msgs::Header(), 1, found));
  Last<LoopMap> late("loop_map");
  const auto map = late.wait_for([](const LoopMap& m) { return m.loops.size() == 1 && !m.loops[0].objects.empty(); });
  ASSERT_TRUE(map);
  EXPECT_EQ(map->header.frame_id, "map");
  EXPECT_TRUE(map->loops[0].kept);
  EXPECT_EQ(map->loops[0].query.x, 1.0);
  EXPECT_EQ(map->loops[0].objects[0].z, 2.0);
  core::MapCorrection correction;
  correction.changed = true;
  correction.valid_to_keyframe_id = 1;
  correction.keyframes.resize(1);
  correction.keyframes[0].keyframe_id = 1;
  correction.keyframes[0].T_map_camera.t.x() = 0.5;
  correction.loops = {{0, 1, 0, false}};
  corrections_.publish(boost::make_shared<CorrectionMessage>(std_msgs::Header(), 1, correction));
  EXPECT_TRUE(late.wait_for([](const LoopMap& m) { return m.loops[0].query.x == 0.5 && !m.loops[0].kept; }));
}

TEST_F(Visualization, WhatANewSessionShowsHasNoStampOfTheOneBefore) {
  Last<LoopMap> map("loop_map");
  ASSERT_TRUE(map.wait_for([](const LoopMap& m) { return m.header.stamp == ros::Time(1.0); }));
  SessionControl start;
  start.session_id = 2;
  start.command = SessionControl::COMMAND_START;
  control_.publish(start);
  EXPECT_TRUE(map.wait_for([](const LoopMap& m) { return m.header.stamp.isZero(); }));
}

TEST(LazyPublisher, IsDueForWhoComesInTheOthersPlace) {
  ros::NodeHandle node;
  LazyPublisher publisher;
  publisher.open<std_msgs::String>(node, "lazy", 1);
  const boost::function<void(const std_msgs::String::ConstPtr&)> ignore = [](const auto&) {};
  ros::Subscriber listener = node.subscribe<std_msgs::String>("lazy", 1, ignore);
  ASSERT_TRUE(wait_until([&publisher] { return publisher.is_due(); }));
  publisher.publish(boost::make_shared<std_msgs::String>());
  EXPECT_FALSE(publisher.is_due());
  listener.shutdown();
  listener = node.subscribe<std_msgs::String>("lazy", 1, ignore);
  EXPECT_TRUE(wait_until([&publisher] { return publisher.is_due(); }));
}

}  // namespace
}  // namespace semantic_topo_loop
