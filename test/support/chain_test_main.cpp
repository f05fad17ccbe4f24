#include <gtest/gtest.h>
#include <ros/ros.h>

/// Of the tests that load the chain into their own process; rostest gives the node's name.
int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "chain_test");
  const ros::NodeHandle node;
  ros::AsyncSpinner spinner(3);  // a test's subscribers, its services, and what answers both
  spinner.start();
  return RUN_ALL_TESTS();
}
