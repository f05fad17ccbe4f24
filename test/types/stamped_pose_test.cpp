#include <gtest/gtest.h>

#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop::core {
namespace {

StampedPoses poses_at(const std::vector<std::int64_t>& stamps) {
  StampedPoses poses;
  for (const std::int64_t stamp : stamps) poses.push_back({stamp, SE3()});
  return poses;
}

TEST(FindStamp, TakesTheNearestWithinTheTolerance) {
  const StampedPoses poses = poses_at({100, 200, 300});
  EXPECT_EQ(find_stamp(poses, 200, 0), &poses[1]);
  EXPECT_EQ(find_stamp(poses, 240, 50), &poses[1]);
  EXPECT_EQ(find_stamp(poses, 260, 50), &poses[2]);
  EXPECT_EQ(find_stamp(poses, 250, 50), &poses[1]);  // the earlier of two equally near ones
  EXPECT_EQ(find_stamp(poses, 90, 10), &poses[0]);
  EXPECT_EQ(find_stamp(poses, 310, 10), &poses[2]);
}

TEST(FindStamp, NullBeyondTheTolerance) {
  const StampedPoses poses = poses_at({100, 200, 300});
  EXPECT_EQ(find_stamp(poses, 250, 49), nullptr);
  EXPECT_EQ(find_stamp(poses, 89, 10), nullptr);
  EXPECT_EQ(find_stamp(poses, 311, 10), nullptr);
  EXPECT_EQ(find_stamp(StampedPoses(), 0, 1000), nullptr);
}

}  // namespace
}  // namespace semantic_topo_loop::core
