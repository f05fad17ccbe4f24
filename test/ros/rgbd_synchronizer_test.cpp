#include <gtest/gtest.h>

#include <utility>
#include <vector>

#include "ros/conversions.h"
#include "ros/rgbd_images.h"

namespace semantic_topo_loop {
namespace {

using Clock = RgbdSynchronizer::Clock;

std::int64_t at_ms(std::int64_t milliseconds) { return (100000 + milliseconds) * 1000000; }

sensor_msgs::ImagePtr image_at(int time_ms) {
  auto image = boost::make_shared<sensor_msgs::Image>();
  image->header.stamp = to_ros_time(at_ms(time_ms));
  return image;
}

class RgbdSynchronizerTest : public ::testing::Test {
 protected:
  void color(int time_ms) { synchronizer_.add_color(image_at(time_ms), now_); }
  void depth(int time_ms) { synchronizer_.add_depth(image_at(time_ms), now_); }
  void wait(double seconds) {
    now_ += std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(seconds));
  }

  std::vector<std::pair<std::int64_t, std::int64_t>> pairs_;
  std::vector<std::int64_t> singles_;
  Clock::time_point now_ = Clock::now();
  RgbdSynchronizer synchronizer_{{},
                                 [this](const auto& color, const auto& depth) {
                                   pairs_.emplace_back(to_stamp_ns(color->header.stamp),
                                                       to_stamp_ns(depth->header.stamp));
                                 },
                                 [this](std::int64_t stamp_ns) { singles_.push_back(stamp_ns); }};
};

TEST_F(RgbdSynchronizerTest, EqualStampsArePairedAtOnce) {
  for (int i = 0; i < 5; ++i) {
    if (i % 2 == 0) color(33 * i);
    depth(33 * i);
    if (i % 2 == 1) color(33 * i);
    ASSERT_EQ(pairs_.size(), i + 1u) << "lockstep playback would wait for ever";
    EXPECT_EQ(pairs_.back(), std::make_pair(at_ms(33 * i), at_ms(33 * i)));
  }
  EXPECT_TRUE(singles_.empty());
}

TEST_F(RgbdSynchronizerTest, PairsTheNearestAndNamesThoseLeftAlone) {
  for (int i = 0; i < 6; ++i) {
    color(33 * i);
    if (i != 2) depth(33 * i + 8);
  }
  ASSERT_GE(pairs_.size(), 4u);
  for (const auto& [color_ns, depth_ns] : pairs_) EXPECT_EQ(depth_ns - color_ns, 8000000);
  EXPECT_EQ(singles_, std::vector<std::int64_t>{at_ms(66)});
}

TEST_F(RgbdSynchronizerTest, GivesUpWhatWaitsTooLong) {
  color(0);
  synchronizer_.expire(now_);
  EXPECT_TRUE(singles_.empty());
  wait(1.1);
  synchronizer_.expire(now_);
  EXPECT_EQ(singles_, std::vector<std::int64_t>{at_ms(0)});
  depth(0);
  EXPECT_TRUE(pairs_.empty()) << "answered already";
}

TEST_F(RgbdSynchronizerTest, FollowsTimeThatJumpsBack) {
  color(10000);
  color(10033);
  color(0);
  EXPECT_EQ(singles_, (std::vector<std::int64_t>{at_ms(10000), at_ms(10033)}));
  depth(0);
  ASSERT_EQ(pairs_.size(), 1u);
  EXPECT_EQ(pairs_.front().first, at_ms(0));
}

TEST_F(RgbdSynchronizerTest, NamesTheSilentTopic) {
  EXPECT_EQ(synchronizer_.starvation(now_), "");
  color(0);
  depth(0);
  wait(2.0);
  color(2000);
  EXPECT_EQ(synchronizer_.starvation(now_), "");
  wait(1.5);
  color(3500);
  const std::string text = synchronizer_.starvation(now_);
  EXPECT_NE(text.find("no images on 'depth'"), std::string::npos) << text;
  EXPECT_NE(text.find("gap between the last stamps 3.500 s"), std::string::npos) << text;
}

TEST_F(RgbdSynchronizerTest, NamesStampsThatNeverMeet) {
  color(0);
  depth(0);
  for (int i = 1; i < 10; ++i) {
    wait(0.5);
    color(500 * i);
    depth(500 * i + 200);
  }
  const std::string text = synchronizer_.starvation(now_);
  EXPECT_NE(text.find("none within 0.020 s"), std::string::npos) << text;
}

}  // namespace
}  // namespace semantic_topo_loop
