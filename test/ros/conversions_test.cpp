#include "ros/conversions.h"

#include <gtest/gtest.h>

#include <limits>

namespace semantic_topo_loop {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

TEST(Time, KeepsEveryNanosecondThatRosTimeCanHold) {
  for (const std::int64_t stamp_ns : {std::int64_t{0}, std::int64_t{1}, std::int64_t{999999999},
                                      std::int64_t{1311868164363181001}, std::int64_t{4294967295999999999}}) {
    EXPECT_EQ(to_stamp_ns(to_ros_time(stamp_ns)), stamp_ns);
  }
  EXPECT_EQ(to_stamp_ns(to_ros_time(-5)), 0);
  EXPECT_EQ(to_stamp_ns(to_ros_time(std::numeric_limits<std::int64_t>::max())), 4294967295999999999);
}

TEST(FrameIds, LoseOneLeadingSlash) {
  EXPECT_EQ(strip_leading_slash("/openni_rgb_optical_frame"), "openni_rgb_optical_frame");
  EXPECT_EQ(strip_leading_slash("world"), "world");
  EXPECT_EQ(strip_leading_slash(""), "");
}

TEST(PointClouds, LeaveOutNonFinitePoints) {
  const std::vector<core::Vec3> given = {
      {1.0, 2.0, 3.0}, {kNaN, 0.0, 1.0}, {4.0, 5.0, std::numeric_limits<double>::infinity()}, {7.0, 8.0, 9.0}};
  sensor_msgs::PointCloud2 cloud;
  to_cloud(given, &cloud);
  const auto points = from_msg(cloud);
  ASSERT_TRUE(points) << points.message();
  EXPECT_EQ(*points, (std::vector<core::Vec3>{{1.0, 2.0, 3.0}, {7.0, 8.0, 9.0}}));
}

TEST(PointClouds, RefuseMissingFieldsAndShortData) {
  EXPECT_EQ(from_msg(sensor_msgs::PointCloud2()).message(), "point cloud field 'x' is missing or not float32");

  const std::vector<core::Vec3> point = {{1.0, 2.0, 3.0}};
  sensor_msgs::PointCloud2 cloud;
  to_cloud(point, &cloud);
  cloud.fields[1].datatype = sensor_msgs::PointField::FLOAT64;
  EXPECT_EQ(from_msg(cloud).message(), "point cloud field 'y' is missing or not float32");

  to_cloud(point, &cloud);
  cloud.data.resize(5);
  const std::string problem = from_msg(cloud).message();
  EXPECT_NE(problem.find("data size = 5 is not width * height * point_step"), std::string::npos) << problem;

  cloud.data.clear();
  cloud.width = 1U << 22;
  cloud.height = cloud.point_step = 1U << 21;  // 2^64 bytes, which are 0 of 64 bits
  EXPECT_FALSE(from_msg(cloud));
}

TEST(CheckedPose, NamesTheBadFieldAndItsValue) {
  geometry_msgs::Pose pose;
  pose.orientation.w = 1.0;
  ASSERT_TRUE(checked_pose(pose, "odom.pose"));
  pose.position.y = kNaN;
  EXPECT_EQ(checked_pose(pose, "odom.pose").message(), "odom.pose.position.y = nan is not finite");
  pose.position.y = 0.0;
  pose.orientation.x = std::numeric_limits<double>::infinity();
  EXPECT_EQ(checked_pose(pose, "odom.pose").message(), "odom.pose.orientation.x = inf is not finite");
}

TEST(CheckedPose, NormalisesSmallErrorsAndRefusesLargeOnes) {
  geometry_msgs::Pose pose;
  pose.orientation.z = 0.6 * 1.001;
  pose.orientation.w = 0.8 * 1.001;
  const auto T = checked_pose(pose, "pose");
  ASSERT_TRUE(T);
  EXPECT_NEAR(T->q.norm(), 1.0, 1e-15);
  pose.orientation.w = 0.0;
  const std::string problem = checked_pose(pose, "pose").message();
  EXPECT_NE(problem.find("pose.orientation norm = 0.6"), std::string::npos) << problem;
}

TEST(CheckedCamera, RefusesOtherLensModelsAndBadNumbers) {
  const core::Camera camera{520.0, 521.0, 320.0, 240.0, 640, 480, {0.2, -0.7, 0.0, 0.0, 0.9}};
  sensor_msgs::CameraInfo message;
  to_msg(camera, &message);
  ASSERT_TRUE(checked_camera(message));
  message.distortion_model = "equidistant";
  const std::string problem = checked_camera(message).message();
  EXPECT_NE(problem.find("equidistant"), std::string::npos) << problem;
  to_msg(camera, &message);
  message.K[0] = kNaN;
  EXPECT_EQ(checked_camera(message).message(), "camera_info fx = nan must be > 0");
  to_msg(camera, &message);
  message.width = message.height = 1000000;
  EXPECT_EQ(checked_camera(message).message(), "camera_info width = 1000000 must be in (0, 10000]");
}

TEST(CameraInfo, OfAPartOfTheSensorOrOfBinnedPixels) {
  sensor_msgs::CameraInfo message;
  message.K = {600.0, 0.0, 640.0, 0.0, 610.0, 360.0, 0.0, 0.0, 1.0};
  message.width = 1280;
  message.height = 720;
  message.binning_x = message.binning_y = 2;
  core::Camera camera = *checked_camera(message);
  EXPECT_EQ((std::vector<double>{camera.fx, camera.fy, camera.cx, camera.cy}),
            (std::vector<double>{300.0, 305.0, 320.0, 180.0}));
  EXPECT_EQ(std::make_pair(camera.width, camera.height), std::make_pair(640, 360));
  message.roi.x_offset = 40;
  message.roi.y_offset = 20;
  message.roi.width = 800;
  message.roi.height = 600;
  camera = *checked_camera(message);
  EXPECT_EQ((std::vector<double>{camera.fx, camera.fy, camera.cx, camera.cy}),
            (std::vector<double>{300.0, 305.0, 300.0, 170.0}));
  EXPECT_EQ(std::make_pair(camera.width, camera.height), std::make_pair(400, 300));
}

}  // namespace
}  // namespace semantic_topo_loop
