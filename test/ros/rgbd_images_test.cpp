#include "ros/rgbd_images.h"

#include <gtest/gtest.h>
#include <sensor_msgs/image_encodings.h>

#include <atomic>
#include <cstring>
#include <limits>
#include <utility>
#include <vector>

#include "ros/conversions.h"
#include "ros/parameters.h"
#include "semantic_topo_loop/pipeline/read_ahead.h"

namespace semantic_topo_loop {
namespace {

namespace encodings = sensor_msgs::image_encodings;

std::int64_t at_ms(std::int64_t milliseconds) { return (100000 + milliseconds) * 1000000; }

sensor_msgs::ImagePtr image_at(int time_ms) {
  auto image = boost::make_shared<sensor_msgs::Image>();
  image->header.stamp = to_ros_time(at_ms(time_ms));
  return image;
}

/// Stamps of the pairs, in ms; -1 for no depth.
std::vector<std::pair<int, int>> take_all(DepthPairing* pairing) {
  const auto to_ms = [](const sensor_msgs::ImagePtr& image) {
    return image ? static_cast<int>((to_stamp_ns(image->header.stamp) - at_ms(0)) / 1000000) : -1;
  };
  std::vector<std::pair<int, int>> pairs;
  while (const auto answer = pairing->take()) pairs.emplace_back(to_ms(answer->color), to_ms(answer->depth));
  return pairs;
}

TEST(DepthPairing, TakesTheNearestOnceItIsClear) {
  DepthPairing pairing(0.02);
  pairing.add_color({}, image_at(0));
  pairing.add_depth(image_at(15));
  EXPECT_TRUE(take_all(&pairing).empty()) << "a nearer one may come";
  pairing.add_depth(image_at(5));
  pairing.add_depth(image_at(40));
  EXPECT_TRUE(take_all(&pairing).empty()) << "a colour image that is nearer to it may come";
  pairing.add_color({}, image_at(33));
  EXPECT_EQ(take_all(&pairing), (std::vector<std::pair<int, int>>{{0, 5}}));
  pairing.add_color({}, image_at(66));
  pairing.finish();
  EXPECT_EQ(take_all(&pairing), (std::vector<std::pair<int, int>>{{33, 40}, {66, -1}}));
}

TEST(DepthPairing, DoesNotWaitForASilentTopic) {
  DepthPairing pairing(0.02);
  for (int i = 0; i < 100; ++i) pairing.add_color({}, image_at(33 * i));
  const std::vector<std::pair<int, int>> pairs = take_all(&pairing);
  ASSERT_GE(pairs.size(), 60u);
  EXPECT_EQ(pairs.front(), std::make_pair(0, -1));
}

TEST(DepthPairing, UsesEachDepthOnce) {
  DepthPairing pairing(0.02);
  pairing.add_color({}, image_at(0));
  pairing.add_color({}, image_at(16));
  pairing.add_depth(image_at(8));
  pairing.finish();
  EXPECT_EQ(take_all(&pairing), (std::vector<std::pair<int, int>>{{0, 8}, {16, -1}}));
}

TEST(DepthPairing, LeavesToTheNextColourImageWhatBelongsToIt) {
  DepthPairing pairing(0.02);
  std::vector<std::pair<int, int>> expected;
  for (int i = 0; i < 20; ++i) {
    const int time_ms = 17 * i;
    pairing.add_color({}, image_at(time_ms));
    if (i % 2 == 1) pairing.add_depth(image_at(time_ms));
    expected.emplace_back(time_ms, i % 2 == 1 ? time_ms : -1);
  }
  pairing.finish();
  EXPECT_EQ(take_all(&pairing), expected);
}

TEST(DepthPairing, KeepsWhatBelongsToAnImageThatColourPausesAfter) {
  DepthPairing pairing(0.02);
  pairing.add_color({}, image_at(0));
  std::vector<std::pair<int, int>> pairs;
  for (int i = 0; i < 60; ++i) {
    pairing.add_depth(image_at(33 * i));
    for (const auto& pair : take_all(&pairing)) pairs.push_back(pair);
  }
  EXPECT_EQ(pairs, (std::vector<std::pair<int, int>>{{0, 0}}));
}

TEST(DepthPairing, LosesNoOtherPairToImagesStampedFarAhead) {
  constexpr int kFarAhead = 60000;
  DepthPairing pairing(0.02);
  std::vector<std::pair<int, int>> pairs, expected;
  for (int i = 0; i < 60; ++i) {
    const int time_ms = i == 20 ? kFarAhead : 33 * i;
    pairing.add_color({}, image_at(time_ms));
    expected.emplace_back(time_ms, i == 20 ? -1 : time_ms + 5);
    for (const auto& pair : take_all(&pairing)) pairs.push_back(pair);
    pairing.add_depth(image_at((i == 40 ? kFarAhead : time_ms) + 5));
    if (i == 40) expected.back().second = -1;
    for (const auto& pair : take_all(&pairing)) pairs.push_back(pair);
  }
  pairing.finish();
  for (const auto& pair : take_all(&pairing)) pairs.push_back(pair);
  EXPECT_EQ(pairs, expected);
}

TEST(DepthPairing, KeepsWhatTheNextColourImageHasANearerOneThan) {
  DepthPairing pairing(0.02);
  for (const int time_ms : {0, 33}) pairing.add_color({}, image_at(time_ms));
  for (const int time_ms : {18, 35}) pairing.add_depth(image_at(time_ms));
  pairing.finish();
  EXPECT_EQ(take_all(&pairing), (std::vector<std::pair<int, int>>{{0, 18}, {33, 35}}));
}

core::Camera camera() { return {100.0, 100.0, 32.0, 24.0, 64, 48, {}}; }

sensor_msgs::Image filled(const std::string& encoding, const std::vector<std::uint8_t>& pixel) {
  sensor_msgs::Image image;
  image.header.stamp = to_ros_time(at_ms(0));
  image.width = 64;
  image.height = 48;
  image.encoding = encoding;
  image.step = static_cast<std::uint32_t>(64 * pixel.size());
  for (int i = 0; i < 64 * 48; ++i) image.data.insert(image.data.end(), pixel.begin(), pixel.end());
  return image;
}

template <class Value>
sensor_msgs::Image depth_of(const std::string& encoding, Value value) {
  std::vector<std::uint8_t> bytes(sizeof(Value));
  std::memcpy(bytes.data(), &value, sizeof(Value));
  return filled(encoding, bytes);
}

TEST(MakeRgbdImage, TakesEveryEncoding) {
  const sensor_msgs::Image depth = depth_of(encodings::TYPE_32FC1, 1.5f);
  for (const auto& [encoding, pixel] :
       std::vector<std::pair<std::string, std::vector<std::uint8_t>>>{{encodings::MONO8, {90}},
                                                                      {encodings::RGB8, {90, 90, 90}},
                                                                      {encodings::BGR8, {90, 90, 90}},
                                                                      {encodings::BGRA8, {90, 90, 90, 255}},
                                                                      {encodings::BAYER_GRBG8, {90}}}) {
    const auto image = make_rgbd_image(filled(encoding, pixel), depth, camera(), {});
    ASSERT_TRUE(image) << encoding << ": " << image.message();
    EXPECT_EQ(image->stamp_ns, at_ms(0));
    EXPECT_EQ(image->gray.type(), CV_8UC1);
    EXPECT_NEAR(image->gray.at<std::uint8_t>(20, 20), 90, 1) << encoding;
    EXPECT_FLOAT_EQ(image->depth_m.at<float>(20, 20), 1.5f);
  }
}

TEST(MakeRgbdImage, CorrectsTheScaleOfBothDepthEncodings) {
  core::DepthOptions options;
  options.scale_correction = 0.96;
  const sensor_msgs::Image color = filled(encodings::RGB8, {10, 20, 30});
  for (const sensor_msgs::Image& depth :
       {depth_of(encodings::TYPE_32FC1, 2.0f), depth_of<std::uint16_t>(encodings::TYPE_16UC1, 2000),
        depth_of<std::uint16_t>(encodings::MONO16, 2000)}) {
    const auto image = make_rgbd_image(color, depth, camera(), options);
    ASSERT_TRUE(image) << depth.encoding << ": " << image.message();
    EXPECT_NEAR(image->depth_m.at<float>(20, 20), 1.92f, 1e-6f) << depth.encoding;
  }
}

// Sizes whose product, in 32 bits, is that of the data.
TEST(ToMat, RefusesSizesThatTheDataDoesNotHave) {
  sensor_msgs::Image image = filled(encodings::MONO8, {90});
  image.height += 1U << 26;  // times 64: 2^32 bytes more
  EXPECT_NE(to_mat(image, encodings::MONO8, "colour").message().find("3072 bytes in rows of 64"), std::string::npos);
  image = filled(encodings::BGRA8, {90, 90, 90, 255});
  image.width += 1U << 30;
  EXPECT_NE(to_mat(image, encodings::MONO8, "colour").message().find("12288 bytes in rows of 256"), std::string::npos);
}

TEST(MakeRgbdImage, RefusesWhatIsNone) {
  const sensor_msgs::Image color = filled(encodings::RGB8, {10, 20, 30});
  const sensor_msgs::Image depth = depth_of(encodings::TYPE_32FC1, 2.0f);
  std::string error = make_rgbd_image(color, filled(encodings::RGB8, {1, 2, 3}), camera(), {}).message();
  EXPECT_NE(error.find("rgb8"), std::string::npos) << error;
  sensor_msgs::Image cut = color;
  cut.data.resize(100);
  EXPECT_FALSE(make_rgbd_image(cut, depth, camera(), {}));
  sensor_msgs::Image strange = color;
  strange.encoding = "jpeg";
  error = make_rgbd_image(strange, depth, camera(), {}).message();
  EXPECT_NE(error.find("jpeg"), std::string::npos) << error;
  sensor_msgs::Image half = depth;
  half.height = 24;
  half.data.resize(half.data.size() / 2);
  EXPECT_FALSE(make_rgbd_image(color, half, camera(), {}));
  sensor_msgs::Image empty;
  EXPECT_FALSE(make_rgbd_image(empty, depth, camera(), {}));
  const auto nothing =
      make_rgbd_image(color, depth_of(encodings::TYPE_32FC1, std::numeric_limits<float>::quiet_NaN()), camera(), {});
  ASSERT_TRUE(nothing) << "the front end says what it thinks of it";
  EXPECT_EQ(nothing->depth_m.at<float>(20, 20), 0.0f);
}

TEST(ReadAhead, KeepsTheOrderAndEnds) {
  int produced = 0;
  core::ReadAhead<int> items(
      [&produced]() -> std::optional<int> {
        if (produced == 100) return std::nullopt;
        return produced++;
      },
      3);
  for (int i = 0; i < 100; ++i) ASSERT_EQ(items.next(), i);
  EXPECT_FALSE(items.next());
  EXPECT_FALSE(items.next());
}

TEST(ReadAhead, CanBeLeftInTheMiddle) {
  std::atomic<int> produced{0};
  {
    core::ReadAhead<int> items([&produced]() -> std::optional<int> { return produced++; }, 3);
    EXPECT_EQ(items.next(), 0);
  }
  EXPECT_LE(produced, 6) << "bounded";
}

TEST(RgbdFrontendParameters, AreStrict) {
  const auto good = make_nodelet_parameters<RgbdFrontendParameters>(
      {{"class_table", "coco.yaml"}, {"depth.scale_correction", "0.96"}});
  ASSERT_TRUE(good) << good.message();
  EXPECT_EQ(good->options.depth.scale_correction, 0.96);
  const auto error_of = [](const std::string& key, const std::string& value) {
    return make_nodelet_parameters<RgbdFrontendParameters>({{"class_table", "coco.yaml"}, {key, value}}).message();
  };
  EXPECT_EQ(error_of("sync_queue_size", "0"), "parameter 'sync_queue_size' = '0' must be >= 1");
  EXPECT_EQ(error_of("odom_frame", ""), "parameter 'odom_frame' = '' must be given");
}

using Clock = RgbdSynchronizer::Clock;

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

TEST_F(RgbdSynchronizerTest, SurvivesStampsThatAreAgesApart) {
  const auto in_2106 = image_at(0);
  in_2106->header.stamp = ros::Time(4'000'000'000U, 0);
  const auto in_1970 = image_at(0);
  in_1970->header.stamp = ros::Time(1, 0);
  for (int i = 0; i < 3; ++i) {
    synchronizer_.add_color(in_1970, now_);
    synchronizer_.add_depth(in_2106, now_);
    synchronizer_.add_color(in_2106, now_);
    synchronizer_.add_depth(in_1970, now_);
  }
  color(0);
  depth(0);
  EXPECT_EQ(pairs_.back(), std::make_pair(at_ms(0), at_ms(0)));
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

TEST_F(RgbdSynchronizerTest, ExcusesSilenceWhileNothingIsAwaited) {
  color(0);
  depth(0);
  wait(60.0);
  EXPECT_NE(synchronizer_.starvation(now_), "");
  synchronizer_.excuse(now_);
  wait(2.9);
  EXPECT_EQ(synchronizer_.starvation(now_), "");
  wait(0.2);
  EXPECT_NE(synchronizer_.starvation(now_), "");
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
