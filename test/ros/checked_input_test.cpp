#include <gtest/gtest.h>

#include <limits>
#include <string>

#include "semantic_topo_loop/ros/conversions.h"

namespace semantic_topo_loop {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

TEST(PointClouds, LeaveOutNonFinitePoints) {
  sensor_msgs::PointCloud2 cloud;
  to_msg({{1.0, 2.0, 3.0}, {kNaN, 0.0, 1.0}, {4.0, 5.0, std::numeric_limits<double>::infinity()}, {7.0, 8.0, 9.0}},
         &cloud);
  const auto points = from_msg(cloud, nullptr);
  ASSERT_TRUE(points);
  ASSERT_EQ(points->size(), 2u);
  EXPECT_EQ((*points)[0], core::Vec3(1.0, 2.0, 3.0));
  EXPECT_EQ((*points)[1], core::Vec3(7.0, 8.0, 9.0));
}

TEST(PointClouds, RefuseMissingFieldsAndShortData) {
  std::string error;
  sensor_msgs::PointCloud2 empty;
  EXPECT_FALSE(from_msg(empty, &error));
  EXPECT_EQ(error, "point cloud field 'x' is missing or not float32");

  sensor_msgs::PointCloud2 cloud;
  to_msg({{1.0, 2.0, 3.0}}, &cloud);
  cloud.fields[1].datatype = sensor_msgs::PointField::FLOAT64;
  EXPECT_FALSE(from_msg(cloud, &error));
  EXPECT_EQ(error, "point cloud field 'y' is missing or not float32");

  to_msg({{1.0, 2.0, 3.0}}, &cloud);
  cloud.data.resize(5);
  EXPECT_FALSE(from_msg(cloud, &error));
  EXPECT_NE(error.find("data size = 5 is not width * height * point_step"), std::string::npos) << error;
}

TEST(CheckedPose, NamesTheBadFieldAndItsValue) {
  geometry_msgs::Pose pose;
  pose.orientation.w = 1.0;
  std::string error;
  ASSERT_TRUE(checked_pose(pose, "odom.pose", &error));
  pose.position.y = kNaN;
  EXPECT_FALSE(checked_pose(pose, "odom.pose", &error));
  EXPECT_EQ(error, "odom.pose.position.y = nan is not finite");
  pose.position.y = 0.0;
  pose.orientation.x = std::numeric_limits<double>::infinity();
  EXPECT_FALSE(checked_pose(pose, "odom.pose", &error));
  EXPECT_EQ(error, "odom.pose.orientation.x = inf is not finite");
}

TEST(CheckedPose, NormalisesSmallErrorsAndRefusesLargeOnes) {
  geometry_msgs::Pose pose;
  pose.orientation.z = 0.6 * 1.001;
  pose.orientation.w = 0.8 * 1.001;
  std::string error;
  const auto T = checked_pose(pose, "pose", &error);
  ASSERT_TRUE(T);
  EXPECT_NEAR(T->q.norm(), 1.0, 1e-15);
  pose.orientation.w = 0.0;
  EXPECT_FALSE(checked_pose(pose, "pose", &error));
  EXPECT_NE(error.find("pose.orientation norm = 0.6"), std::string::npos) << error;
}

TEST(CheckedCamera, RefusesOtherLensModelsAndBadNumbers) {
  core::Camera camera{520.0, 521.0, 320.0, 240.0, 640, 480, {0.2, -0.7, 0.0, 0.0, 0.9}};
  sensor_msgs::CameraInfo message;
  to_msg(camera, &message);
  std::string error;
  ASSERT_TRUE(checked_camera(message, &error));
  message.distortion_model = "equidistant";
  EXPECT_FALSE(checked_camera(message, &error));
  EXPECT_NE(error.find("equidistant"), std::string::npos) << error;
  to_msg(camera, &message);
  message.K[0] = kNaN;
  EXPECT_FALSE(checked_camera(message, &error));
  EXPECT_EQ(error, "camera_info fx = nan must be > 0");
}

TEST(CheckedDetection, RefusesNaNAndTurnedBoxes) {
  const core::Detection good{41, 0.9, {10.0, 20.0, 30.0, 40.0}};
  std::string error;
  ASSERT_TRUE(checked_detection(to_msg(good), &error));
  Detection message = to_msg(good);
  message.box.x2 = 5.0;
  EXPECT_FALSE(checked_detection(message, &error));
  EXPECT_EQ(error, "box.x2 = 5 is not greater than x1");
  message = to_msg(good);
  message.box.y1 = kNaN;
  EXPECT_FALSE(checked_detection(message, &error));
  EXPECT_EQ(error, "box.y1 = nan is not finite");
  message = to_msg(good);
  message.score = 1.5;
  EXPECT_FALSE(checked_detection(message, &error));
  EXPECT_EQ(error, "score = 1.5 is not in [0, 1]");
}

}  // namespace
}  // namespace semantic_topo_loop
