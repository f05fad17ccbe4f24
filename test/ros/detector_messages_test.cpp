#include "ros/detector_messages.h"

#include <darknet_ros_msgs/BoundingBoxes.h>
#include <geometry_msgs/Point.h>
#include <gtest/gtest.h>
#include <vision_msgs/Detection2DArray.h>

#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "ros/conversions.h"
#include "semantic_topo_loop/io/yaml_files.h"
#include "semantic_topo_loop/ros/messages.h"

namespace semantic_topo_loop {
namespace {

constexpr int kCup = 41;
constexpr std::int64_t kStamp_ns = 1311868164363181000;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

/// The message as it comes from a socket, or only the first bytes of it.
template <class Message>
DetectorMessage over_the_wire(const Message& message, std::size_t bytes = std::string::npos) {
  std::vector<std::uint8_t> buffer(ros::serialization::serializationLength(message));
  ros::serialization::OStream out(buffer.data(), static_cast<std::uint32_t>(buffer.size()));
  ros::serialization::serialize(out, message);
  ros::serialization::IStream in(buffer.data(), static_cast<std::uint32_t>(std::min(bytes, buffer.size())));
  DetectorMessage received;
  received.morph(ros::message_traits::md5sum<Message>(), ros::message_traits::datatype<Message>(),
                 ros::message_traits::definition<Message>(), "");
  received.read(in);
  return received;
}

class DetectorMessages : public ::testing::Test {
 protected:
  core::Result<core::DetectionFrame> read(const DetectorMessage& message) {
    static const core::ClassTable classes = *core::read_class_table(STL_CONFIG_DIR "/classes_coco.yaml");
    left_out_.clear();
    const auto note = [this](std::size_t index, core::DetectionProblem problem, const std::string& value) {
      left_out_ += std::to_string(index) + ": " + to_string(problem) + ": " + value + "\n";
    };
    core::Result<core::DetectionFrame> frame = read_detector_message(message, classes, note);
    if (frame) frame->detections = core::usable_boxes(frame->detections, classes, 200, note);
    return frame;
  }
  template <class Message>
  core::DetectionFrame read_all(const Message& message) {
    const auto frame = read(over_the_wire(message));
    EXPECT_TRUE(frame) << frame.message();
    return frame ? *frame : core::DetectionFrame();
  }
  static void expect_cup(const core::Detection& cup, const core::Vec4& edges) {
    EXPECT_EQ(cup.class_id, kCup);
    EXPECT_EQ(cup.score, 0.75);
    EXPECT_LT((cup.box.edges() - edges).norm(), 1e-9) << cup.box.edges().transpose();
  }
  /// Every message that ends too early.
  template <class Message>
  void expect_all_bytes_needed(const Message& message) {
    const std::size_t length = ros::serialization::serializationLength(message);
    for (std::size_t bytes = 0; bytes < length; ++bytes) {
      const auto frame = read(over_the_wire(message, bytes));
      ASSERT_FALSE(frame) << bytes;
      EXPECT_EQ(frame.message().find(ros::message_traits::datatype<Message>()), 0u) << frame.message();
    }
  }

  std::string left_out_;
};

vision_msgs::Detection2D vision_box(std::int64_t id, double score, double width, double height, double theta = 0.0) {
  vision_msgs::Detection2D detection;
  detection.results.resize(1);
  detection.results[0].id = id;
  detection.results[0].score = score;
  detection.bbox.center.x = 320.0;
  detection.bbox.center.y = 240.0;
  detection.bbox.center.theta = theta;
  detection.bbox.size_x = width;
  detection.bbox.size_y = height;
  return detection;
}

darknet_ros_msgs::BoundingBox darknet_box(const std::string& name, double score, std::int64_t x1, std::int64_t x2) {
  darknet_ros_msgs::BoundingBox box;
  box.Class = name;
  box.id = 3;  // of the network, not of the table
  box.probability = score;
  box.xmin = x1;
  box.xmax = x2;
  box.ymin = 200;
  box.ymax = 260;
  return box;
}

TEST_F(DetectorMessages, OurOwn) {
  DetectionsMessage message;
  message.header.stamp = to_ros_time(kStamp_ns);
  message.detections = {{kCup, 0.75, {1.0, 2.0, 3.0, 4.0}}};
  const core::DetectionFrame frame = read_all(message);
  EXPECT_EQ(frame.stamp_ns, kStamp_ns);
  ASSERT_EQ(frame.detections.size(), 1u);
  expect_cup(frame.detections[0], {1.0, 2.0, 3.0, 4.0});
  expect_all_bytes_needed(message);
}

TEST_F(DetectorMessages, WithoutAStampAreOfNoImage) {
  // Some detectors stamp each box alone: then nothing tells which image an empty array is of.
  EXPECT_EQ(read(over_the_wire(vision_msgs::Detection2DArray())).message(),
            "vision_msgs/Detection2DArray: header.stamp is 0");
}

TEST_F(DetectorMessages, OfVisionMsgs) {
  vision_msgs::Detection2DArray message;
  message.header.stamp = to_ros_time(kStamp_ns);
  message.detections = {vision_box(kCup, 0.75, 40.0, 20.0), vision_box(kCup, 0.75, 40.0, 20.0, M_PI / 6.0)};
  // The best of what it may be.
  message.detections[0].results.insert(message.detections[0].results.begin(), 2, vision_box(63, 0.2, 1, 1).results[0]);
  const core::DetectionFrame frame = read_all(message);
  EXPECT_EQ(frame.stamp_ns, kStamp_ns);
  ASSERT_EQ(frame.detections.size(), 2u) << left_out_;
  expect_cup(frame.detections[0], {300.0, 230.0, 340.0, 250.0});
  const double half_width = 20.0 * std::sqrt(0.75) + 5.0, half_height = 10.0 + 10.0 * std::sqrt(0.75);
  expect_cup(frame.detections[1], {320 - half_width, 240 - half_height, 320 + half_width, 240 + half_height});
  expect_all_bytes_needed(message);
}

TEST_F(DetectorMessages, OfVisionMsgsHaveTheStampOfTheImageWhereOneIsThere) {
  vision_msgs::Detection2DArray message;
  message.header.stamp = to_ros_time(kStamp_ns + 300'000'000);  // when the detector was done
  message.detections = {vision_box(kCup, 0.75, 40.0, 20.0)};
  EXPECT_EQ(read_all(message).stamp_ns, kStamp_ns + 300'000'000);
  message.detections[0].header.stamp = to_ros_time(kStamp_ns + 100'000'000);
  EXPECT_EQ(read_all(message).stamp_ns, kStamp_ns + 100'000'000);
  message.detections[0].source_img.header.stamp = to_ros_time(kStamp_ns);
  EXPECT_EQ(read_all(message).stamp_ns, kStamp_ns);
}

TEST_F(DetectorMessages, BadBoxesOfVisionMsgsAreLeftOut) {
  vision_msgs::Detection2DArray message;
  message.header.stamp = to_ros_time(kStamp_ns);
  EXPECT_TRUE(read_all(message).detections.empty()) << "nothing seen";
  message.detections = {vision_box(91, 0.5, 40, 20),    vision_box(1LL << 40, 0.5, 40, 20),
                        vision_box(kCup, 0.5, -40, 20), vision_box(kCup, 0.5, kNan, 20),
                        vision_box(kCup, kNan, 40, 20), vision_box(kCup, 0.5, 40, 20, kNan),
                        vision_box(kCup, 0.75, 40, 20), vision_box(kCup, 0.5, 40, 0)};
  EXPECT_EQ(read_all(message).detections.size(), 1u);
  EXPECT_EQ(left_out_.substr(0, left_out_.find('\n')), "0: unknown class id: class id 91");
  EXPECT_NE(left_out_.find("1: unknown class id: class id 2147483647"), std::string::npos) << left_out_;
  EXPECT_NE(left_out_.find("2: box has x2 <= x1"), std::string::npos) << left_out_;
  for (const char* place : {"3: box is not finite", "4: score is not in", "5: box is not finite", "7: box has x2"}) {
    EXPECT_NE(left_out_.find(place), std::string::npos) << left_out_;
  }
  message.detections = {vision_box(kCup, 0.5, 40, 20)};
  message.detections[0].results.clear();
  EXPECT_TRUE(read_all(message).detections.empty());
  EXPECT_EQ(left_out_, "0: unknown class id: results is empty\n");
}

TEST_F(DetectorMessages, OfDarknetRos) {
  darknet_ros_msgs::BoundingBoxes message;
  message.header.stamp = to_ros_time(kStamp_ns + 90'000'000);  // when the answer was ready
  message.image_header.stamp = to_ros_time(kStamp_ns);
  EXPECT_TRUE(read_all(message).detections.empty()) << "nothing seen";
  message.bounding_boxes = {darknet_box("teapot", 0.75, 300, 340), darknet_box("cup", 0.75, 300, 340),
                            darknet_box("cup", 0.75, 340, 300), darknet_box("cup", kNan, 300, 340)};
  const core::DetectionFrame frame = read_all(message);
  EXPECT_EQ(frame.stamp_ns, kStamp_ns);
  ASSERT_EQ(frame.detections.size(), 1u) << left_out_;
  expect_cup(frame.detections[0], {300.0, 200.0, 340.0, 260.0});
  EXPECT_EQ(left_out_.find("0: unknown class id: class 'teapot'"), 0u) << left_out_;
  EXPECT_NE(left_out_.find("box has x2 <= x1"), std::string::npos) << left_out_;
  EXPECT_NE(left_out_.find("score is not in"), std::string::npos) << left_out_;
  expect_all_bytes_needed(message);
}

TEST_F(DetectorMessages, OtherTypesAndVersionsAreNamed) {
  EXPECT_EQ(
      read(over_the_wire(geometry_msgs::Point())).message(),
      "type geometry_msgs/Point, but this build reads vision_msgs/Detection2DArray, darknet_ros_msgs/BoundingBoxes, "
      "semantic_topo_loop/DetectionArray");
  DetectorMessage other = over_the_wire(vision_msgs::Detection2DArray());
  other.morph(std::string(32, '0'), other.getDataType(), "", "");
  EXPECT_EQ(read(other).message().find("vision_msgs/Detection2DArray: "), 0u) << read(other).message();
  EXPECT_NE(read(other).message().find("md5sum"), std::string::npos) << read(other).message();
}

}  // namespace
}  // namespace semantic_topo_loop
