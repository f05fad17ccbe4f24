#include "semantic_topo_loop/frontend/rgbd_image.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <sstream>

#include "support/synthetic_room.h"

namespace semantic_topo_loop::core {
namespace {

const Camera kCamera = SyntheticRoom::small_camera();

/// An image of one value.
cv::Mat even(int type, const cv::Scalar& value) { return {kCamera.height, kCamera.width, type, value}; }
cv::Mat gray() { return even(CV_8UC1, 100.0); }

Result<RgbdImage> image_of(const cv::Mat& depth, const DepthOptions& options = {}) {
  return make_rgbd_image(7, gray(), depth, kCamera, options);
}

TEST(RgbdImage, MillimetresAndMetresGiveTheSameDepthWithCorrection) {
  DepthOptions options;
  options.scale_correction = 0.96;
  const auto from_raw = image_of(even(CV_16UC1, 2500.0), options);
  const auto from_metres = image_of(even(CV_32FC1, 2.5), options);
  ASSERT_TRUE(from_raw && from_metres) << from_raw.message() << from_metres.message();
  EXPECT_EQ(from_raw->stamp_ns, 7);
  EXPECT_NEAR(from_raw->depth_m.at<float>(10, 20), 2.4, 1e-6);
  EXPECT_NEAR(from_metres->depth_m.at<float>(10, 20), 2.4, 1e-6);
}

TEST(RgbdImage, TumScale) {
  DepthOptions options;
  options.scale = 5000.0;
  const auto image = image_of(even(CV_16UC1, 7500.0), options);
  ASSERT_TRUE(image);
  EXPECT_NEAR(image->depth_m.at<float>(0, 0), 1.5, 1e-6);
}

TEST(RgbdImage, InvalidAndFarValuesAreNoDepth) {
  DepthOptions options;
  options.invalid_values = "0 65535 1234";
  options.max_m = 3.0;
  cv::Mat raw = even(CV_16UC1, {1000});
  raw.at<std::uint16_t>(0, 0) = 0;
  raw.at<std::uint16_t>(0, 1) = 65535;
  raw.at<std::uint16_t>(0, 2) = 1234;
  raw.at<std::uint16_t>(0, 3) = 3001;
  const auto a = image_of(raw, options);
  cv::Mat metres = even(CV_32FC1, {1.0});
  metres.at<float>(0, 0) = std::numeric_limits<float>::quiet_NaN();
  metres.at<float>(0, 1) = std::numeric_limits<float>::infinity();
  metres.at<float>(0, 2) = -1.0F;
  metres.at<float>(0, 3) = 3.001F;
  const auto b = image_of(metres, options);
  ASSERT_TRUE(a && b);
  for (int u = 0; u < 4; ++u) {
    EXPECT_EQ(a->depth_m.at<float>(0, u), 0.0F) << u;
    EXPECT_EQ(b->depth_m.at<float>(0, u), 0.0F) << u;
  }
  EXPECT_EQ(a->depth_m.at<float>(0, 4), 1.0F);
  EXPECT_EQ(b->depth_m.at<float>(0, 4), 1.0F);
}

/// What images are warned of, all of whose depths are one value.
std::string range_warning(const cv::Mat& depth, const DepthOptions& options, int images = 100) {
  DepthRange range;
  for (int i = 0; i < images; ++i) {
    const auto image = image_of(depth, options);
    if (image) range.add(image->depth_range);
  }
  return range.warning(options);
}

TEST(RgbdImage, WrongScaleOfDepthIsNamed) {
  // TUM's PNG files, two metres: a fifth of a metre is a thousand.
  cv::Mat raw = even(CV_16UC1, {10000});
  DepthOptions options;
  const std::string far = range_warning(raw, options);
  EXPECT_NE(far.find("100 % of the depth lies beyond depth.max_m = 8 m"), std::string::npos) << far;
  EXPECT_NE(far.find("depth.scale = 1000"), std::string::npos) << far;
  EXPECT_EQ(range_warning(raw, options, 1), "") << "one image says too little";
  options.scale = 5000.0;
  EXPECT_EQ(range_warning(raw, options), "");
  raw.setTo(1400);
  const std::string near = range_warning(raw, options);
  EXPECT_NE(near.find("100 % of the depth is nearer than 0.3 m"), std::string::npos) << near;
  EXPECT_NE(near.find("depth.scale = 5000"), std::string::npos) << near;
  // Some far and some near depth is nothing unusual; pixels without depth do not count.
  options.scale = 1000.0;
  raw.rowRange(0, kCamera.height / 2).setTo(65535);
  raw.rowRange(kCamera.height / 2, kCamera.height).setTo(310);
  raw.rowRange(kCamera.height * 5 / 6, kCamera.height).setTo(9000);
  EXPECT_NE(range_warning(raw, options).find("33 % of the depth lies beyond"), std::string::npos);
  raw.rowRange(kCamera.height * 5 / 6, kCamera.height * 23 / 24).setTo(0);
  EXPECT_EQ(range_warning(raw, options), "");
}

TEST(RgbdImage, FloatsInMillimetresAreNamed) {
  cv::Mat millimetres = even(CV_32FC1, {2000.0});
  EXPECT_NE(range_warning(millimetres, {}).find("32FC1"), std::string::npos);
  millimetres.setTo(std::numeric_limits<float>::infinity());
  EXPECT_EQ(range_warning(millimetres, {}), "") << "no depth at all";
}

TEST(RgbdImage, ColorBecomesGray) {
  cv::Mat color = even(CV_8UC3, {0, 0, 200});
  const cv::Mat depth = even(CV_32FC1, {1.0});
  const auto image = make_rgbd_image(0, color, depth, kCamera, {});
  ASSERT_TRUE(image);
  EXPECT_EQ(image->gray.type(), CV_8UC1);
  EXPECT_NEAR(image->gray.at<std::uint8_t>(5, 5), 0.299 * 200, 1.0);  // red in BGR
}

/// A wall 2 m before both cameras, the depth camera 10 cm to the left: what it sees at u moves by f b / z to the left.
TEST(RgbdImage, UnregisteredDepthIsSeenByTheColorCamera) {
  DepthOptions options;
  options.color_from_depth = "-0.1 0 0.5 0 0 0 1";
  options.intrinsics = "300 300 100 80";
  cv::Mat depth = cv::Mat::zeros(160, 200, CV_16UC1);
  depth.at<std::uint16_t>(80, 100) = 1500;
  const auto image = image_of(depth, options);
  ASSERT_TRUE(image) << image.message();
  const Vec2 expected(kCamera.fx * -0.1 / 2.0 + kCamera.cx, kCamera.cy);
  EXPECT_EQ(cv::countNonZero(image->depth_m), 4);
  EXPECT_NEAR(image->depth_m.at<float>(static_cast<int>(expected.y()), static_cast<int>(expected.x())), 2.0, 1e-6);
}

TEST(RgbdImage, CoarseDepthLeavesNoHoles) {
  DepthOptions options;
  options.color_from_depth = "0 0 0 0 0 0 1";
  const int width = kCamera.width / 4, height = kCamera.height / 4;
  std::ostringstream pinhole;
  pinhole << kCamera.fx / 4 << ' ' << kCamera.fy / 4 << ' ' << kCamera.cx / 4 << ' ' << kCamera.cy / 4;
  options.intrinsics = pinhole.str();
  const cv::Mat depth(height, width, CV_16UC1, cv::Scalar(1500));
  const auto image = image_of(depth, options);
  ASSERT_TRUE(image) << image.message();
  const cv::Rect inside(8, 8, kCamera.width - 16, kCamera.height - 16);
  EXPECT_EQ(cv::countNonZero(image->depth_m(inside)), inside.area());
  options.intrinsics.clear();
  EXPECT_NE(image_of(depth, options).message().find("depth.intrinsics is empty"), std::string::npos);
}

TEST(RgbdImage, NoisyDepthOfAnotherCameraIsNoNearer) {
  constexpr double kSigma_m = 0.01;
  DepthOptions options;
  options.color_from_depth = "0.025 0 0 0 0 0 1";
  cv::Mat depth(kCamera.height, kCamera.width, CV_32FC1);
  cv::RNG(1).fill(depth, cv::RNG::NORMAL, 2.0, kSigma_m);
  const auto image = image_of(depth, options);
  ASSERT_TRUE(image) << image.message();
  EXPECT_NEAR(cv::mean(image->depth_m, image->depth_m > 0.0)[0], 2.0, 0.05 * kSigma_m);
}

TEST(RgbdImage, NearerSurfaceWinsWhereTwoMeet) {
  DepthOptions options;
  options.color_from_depth = "0.3 0 0 0 0 0 1";
  cv::Mat depth = cv::Mat::zeros(kCamera.height, kCamera.width, CV_32FC1);
  // Both end up at the same pixel: f (x + b) / z is the same.
  const auto u_of = [](double x, double z) { return static_cast<int>(std::lround(kCamera.fx * x / z + kCamera.cx)); };
  depth.at<float>(100, u_of(0.0, 3.0)) = 3.0F;
  depth.at<float>(100, u_of(-0.2, 1.0)) = 1.0F;
  const auto image = image_of(depth, options);
  ASSERT_TRUE(image);
  const int u = static_cast<int>(kCamera.fx * 0.1 + kCamera.cx);
  float nearest = 9.0F;
  for (int x = u - 1; x <= u + 1; ++x) {
    if (image->depth_m.at<float>(100, x) > 0.0F) nearest = std::min(nearest, image->depth_m.at<float>(100, x));
  }
  EXPECT_NEAR(nearest, 1.0, 1e-6);
}

TEST(RgbdImage, WrongImagesAreNamed) {
  const cv::Mat depth = even(CV_16UC1, {1000});
  const cv::Mat small(10, 20, CV_16UC1, cv::Scalar(1000)), bytes(kCamera.height, kCamera.width, CV_8UC1, cv::Scalar(1));
  const cv::Mat doubles = even(CV_64FC1, {1.0});
  const auto error_of = [](const cv::Mat& color, const cv::Mat& d) {
    return make_rgbd_image(42, color, d, kCamera, {}).message();
  };
  EXPECT_NE(error_of(gray(), small).find("depth image of 20 x 10"), std::string::npos);
  EXPECT_NE(error_of(gray(), small).find("42 ns"), std::string::npos);
  EXPECT_NE(error_of(gray(), bytes).find("not 16UC1 or 32FC1"), std::string::npos);
  EXPECT_NE(error_of(doubles, depth).find("not 8UC1 or 8UC3"), std::string::npos);
  EXPECT_NE(error_of(cv::Mat(), depth).find("color image of 0 x 0"), std::string::npos);
  EXPECT_NE(error_of(gray(), cv::Mat()).find("depth image of 0 x 0"), std::string::npos);
}

TEST(DepthOptions, BadValuesAreNamed) {
  const auto error_of = [](auto change) {
    DepthOptions options;
    change(&options);
    const Status status = validate(options);
    EXPECT_FALSE(status);
    return status.message();
  };
  EXPECT_NE(error_of([](DepthOptions* o) { o->scale = 0.0; }).find("depth.scale"), std::string::npos);
  EXPECT_NE(error_of([](DepthOptions* o) { o->invalid_values = "0 x"; }).find("'0 x'"), std::string::npos);
  EXPECT_NE(error_of([](DepthOptions* o) { o->invalid_values = "70000"; }).find("invalid_values"), std::string::npos);
  EXPECT_NE(error_of([](DepthOptions* o) { o->color_from_depth = "0 0 0"; }).find("color_from_depth"),
            std::string::npos);
  EXPECT_NE(error_of([](DepthOptions* o) { o->color_from_depth = "0 0 0 1 1 0 0"; }).find("color_from_depth"),
            std::string::npos);
  EXPECT_NE(error_of([](DepthOptions* o) { o->intrinsics = "500 500 320 240"; }).find("intrinsics"), std::string::npos);
  EXPECT_TRUE(validate(DepthOptions())) << validate(DepthOptions()).message();
}

}  // namespace
}  // namespace semantic_topo_loop::core
