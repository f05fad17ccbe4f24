#include "loop/graph/up_estimator.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "support/depth_scene.h"

namespace semantic_topo_loop::core {
namespace {

using testing::DepthScene;
using testing::on_table;

const Camera kCamera{525.0, 525.0, 320.0, 240.0, 640, 480, {}};

/// A camera 0.8 m over the table that looks down by `pitch_deg` and rolls by `roll_deg`.
SE3 pose_at(double yaw_deg, double pitch_deg, double roll_deg) {
  const auto turn = [](double deg, const Vec3& axis) { return Quaternion(Eigen::AngleAxisd(radians(deg), axis)); };
  Mat3 level;  // x right, y down, z forward, of a camera that looks along the world's x
  level << 0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0;
  const Quaternion q = turn(yaw_deg, Vec3::UnitZ()) * Quaternion(level) * turn(-pitch_deg, Vec3::UnitX()) *
                       turn(roll_deg, Vec3::UnitZ());
  return {q, Vec3(-0.9, 0.1, 0.8)};
}

Frame frame_at(int k, const SE3& pose, std::shared_ptr<const std::vector<Vec3>> points) {
  Frame frame;
  frame.frame_id = k;
  frame.stamp_ns = k * 100'000'000LL;
  frame.T_odom_camera = pose;
  frame.camera = kCamera;
  frame.points_camera = std::move(points);
  return frame;
}

double error_deg(const UpDirection& up, const SE3& pose) {
  return degrees(std::acos(std::min(1.0, (pose.q * up.direction).z())));
}

TEST(UpEstimator, ATableTellsUpToACameraThatHardlyTurnsAndIsHeldAskew) {
  const DepthScene scene{{on_table(0.0, 0.0, Vec3(0.1, 0.1, 0.1)), on_table(0.2, 0.3, Vec3(0.06, 0.2, 0.18))}};
  UpEstimator with_points(33.0), without(33.0);
  SE3 pose;
  for (int k = 0; k < 12; ++k) {
    pose = pose_at(k % 3, 40.0 + k % 4, 6.0);
    const auto points = std::make_shared<const std::vector<Vec3>>(scene.look(kCamera, pose, 1 + k));
    with_points.push(frame_at(k, pose, points));
    without.push(frame_at(k, pose, nullptr));
  }
  const UpDirection up = with_points.estimate(pose.q);
  EXPECT_TRUE(up.certain);
  EXPECT_LT(error_deg(up, pose), 1.0);
  EXPECT_FALSE(without.estimate(pose.q).certain);
  Frame broken = frame_at(13, pose, nullptr);
  broken.is_break = true;
  with_points.push(broken);
  EXPECT_FALSE(with_points.estimate(pose.q).certain) << "what was before a break is of another frame";
}

TEST(UpEstimator, AWallIsNotTakenForAFloor) {
  UpEstimator up(33.0);
  auto wall = std::make_shared<std::vector<Vec3>>();
  for (int i = -20; i <= 20; ++i) {
    for (int j = -15; j <= 15; ++j) wall->push_back({0.05 * i, 0.05 * j, 2.0});
  }
  const SE3 pose = pose_at(0.0, 0.0, 0.0);
  for (int k = 0; k < 12; ++k) up.push(frame_at(k, pose, wall));
  EXPECT_FALSE(up.estimate(pose.q).certain);
}

TEST(UpEstimator, WithoutUsefulPointsItIsAsWithoutPoints) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  UpEstimator with_points(33.0), without(33.0);
  SE3 pose;
  for (int k = 0; k < 200; ++k) {
    pose = pose_at(0.6 * k, 30.0, 3.0 * std::sin(k));
    const std::vector<Vec3> points(k % 2 == 0 ? 0 : 30, k % 3 == 0 ? Vec3(nan, nan, nan) : Vec3(0.0, 0.0, -1.0));
    with_points.push(frame_at(k, pose, std::make_shared<const std::vector<Vec3>>(points)));
    without.push(frame_at(k, pose, nullptr));
  }
  EXPECT_EQ(with_points.estimate(pose.q).certain, without.estimate(pose.q).certain);
  EXPECT_EQ(with_points.estimate(pose.q).direction, without.estimate(pose.q).direction);
}

}  // namespace
}  // namespace semantic_topo_loop::core
