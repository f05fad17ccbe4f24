#include "semantic_topo_loop/io/tum_trajectory.h"

#include <gtest/gtest.h>

#include "support/random_poses.h"
#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

class TumTrajectory : public ::testing::Test {
 protected:
  bool read(const std::string& text) {
    const auto poses = read_tum_trajectory(directory_.write("t.txt", text));
    error_ = poses.message();
    poses_ = poses ? *poses : StampedPoses();
    return static_cast<bool>(poses);
  }
  void expect_error(const std::string& text, const std::string& message) {
    EXPECT_FALSE(read(text)) << text;
    EXPECT_NE(error_.find(directory_.path("t.txt") + message), std::string::npos) << error_;
  }

  TestDirectory directory_;
  StampedPoses poses_;
  std::string error_;
};

TEST_F(TumTrajectory, ReadsPosesAndSkipsComments) {
  ASSERT_TRUE(
      read("# stamp tx ty tz qx qy qz qw\n1311868164.363181 1 -2 3.5 0 0 0 1\n\n1311868164.40 0 0 0 0.6 0 0 0.8\n"))
      << error_;
  ASSERT_EQ(poses_.size(), 2u);
  EXPECT_EQ(poses_[0].stamp_ns, 1311868164363181000);
  EXPECT_EQ(poses_[0].T_world_camera.t, Vec3(1.0, -2.0, 3.5));
  EXPECT_EQ(poses_[1].stamp_ns, 1311868164400000000);
  EXPECT_EQ(poses_[1].T_world_camera.q.coeffs(), Vec4(0.6, 0.0, 0.0, 0.8));
}

TEST_F(TumTrajectory, NormalisesRoundedQuaternions) {
  ASSERT_TRUE(read("1.0 0 0 0 0.6453 -0.5498 0.3363 -0.4101\n2.0 0 0 0 0 0 0 1.009")) << error_;
  for (const StampedPose& pose : poses_) EXPECT_NEAR(pose.T_world_camera.q.norm(), 1.0, 1e-15);
}

TEST_F(TumTrajectory, ErrorsNameFileLineAndValue) {
  expect_error("1.0 0 0 0 0 0 0 1\n2.0 0 0 0 0 0 1\n", ":2: 7 columns instead of 8");
  expect_error("1.0 0 0 0 0 0 0 1 9\n", ":1: 9 columns instead of 8");
  expect_error("\nabc 0 0 0 0 0 0 1\n", ":2: stamp 'abc'");
  expect_error("1.0 0 0 nan 0 0 0 1\n", ":1: tz 'nan' is no finite number");
  expect_error("1.0 0 0 0 inf 0 0 1\n", ":1: qx 'inf' is no finite number");
  expect_error("1.0 0 zero 0 0 0 0 1\n", ":1: ty 'zero' is no finite number");
  expect_error("1.0 0 0 0 0 0 0 0\n", ":1: quaternion of norm 0 is no rotation");
  expect_error("1.0 0 0 0 0 0 0 1.02\n", ":1: quaternion of norm 1.02 is no rotation");
  expect_error("1.0 0 0 0 0 0 0 1\n2.0 0 0 0 0 0 0 1\n1.5 0 0 0 0 0 0 1\n",
               ":3: stamp 1.500000 is not after the one before, 2.000000");
  expect_error("1.0 0 0 0 0 0 0 1\n1.00 0 0 0 0 0 0 1\n", ":2: stamp 1.000000 is not after the one before, 1.000000");
  expect_error("", ": contains no pose");
  expect_error("# only a comment\n", ": contains no pose");
  EXPECT_EQ(read_tum_trajectory(directory_.path("none.txt")).message(),
            directory_.path("none.txt") + ": cannot open the file");
  EXPECT_FALSE(read_tum_trajectory(directory_.path("none.txt")));
}

TEST_F(TumTrajectory, GroundTruthMayRepeatAStamp) {
  const std::string path =
      directory_.write("gt.txt", "1.0 0 0 0 0 0 0 1\n2.0 1 0 0 0 0 0 1\n2.0 2 0 0 0 0 0 1\n3.0 3 0 0 0 0 0 1\n");
  const auto poses = read_tum_ground_truth(path);
  ASSERT_TRUE(poses) << poses.message();
  ASSERT_EQ(poses->size(), 3u);
  EXPECT_EQ((*poses)[1].T_world_camera.t.x(), 2.0);
  EXPECT_FALSE(read_tum_ground_truth(directory_.write("gt.txt", "2.0 1 0 0 0 0 0 1\n1.0 2 0 0 0 0 0 1\n")));
}

TEST_F(TumTrajectory, WrittenPosesComeBack) {
  RandomPoses random(4);
  StampedPoses poses;
  for (int i = 0; i < 20; ++i) poses.push_back({1500000000000000000 + i * 33333333, random.pose(10.0)});
  ASSERT_EQ(write_tum_trajectory(directory_.path("out.txt"), poses).message(), "");
  const auto back = read_tum_trajectory(directory_.path("out.txt"));
  ASSERT_TRUE(back) << back.message();
  ASSERT_EQ(back->size(), poses.size());
  for (std::size_t i = 0; i < poses.size(); ++i) {
    EXPECT_EQ((*back)[i].stamp_ns, poses[i].stamp_ns);
    EXPECT_NEAR(((*back)[i].T_world_camera.matrix() - poses[i].T_world_camera.matrix()).norm(), 0.0, 1e-8);
  }
}

TEST_F(TumTrajectory, LineFormat) {
  EXPECT_EQ(format_tum_pose({1311868164363181000, SE3(Quaternion::Identity(), Vec3(0.5, -1.0, 2.0))}),
            "1311868164.363181 0.500000000 -1.000000000 2.000000000 0.000000000 0.000000000 0.000000000 1.000000000");
}

TEST_F(TumTrajectory, ReadsTheSharedRecordings) {
  const auto file = shared_data("tum/fr2_desk/orbslam2_rgbd_trajectory.txt");
  if (!file) GTEST_SKIP() << "SEMANTIC_TOPO_LOOP_DATA is not set";
  const auto poses = read_tum_trajectory(*file);
  ASSERT_TRUE(poses) << poses.message();
  EXPECT_EQ(poses->size(), 2893u);
}

}  // namespace
}  // namespace semantic_topo_loop::core
