#include "semantic_topo_loop/frontend/keyframe_points.h"

#include <gtest/gtest.h>

#include <cmath>

namespace semantic_topo_loop::core {
namespace {

const Camera kCamera{500.0, 500.0, 320.0, 240.0, 640, 480, {}};

/// A light square, 1 m away, before a dark wall at 3 m.
RgbdImage square_before_wall() {
  RgbdImage image;
  image.gray = cv::Mat(480, 640, CV_8UC1, cv::Scalar(40));
  image.depth_m = cv::Mat(480, 640, CV_32FC1, cv::Scalar(3.0F));
  const cv::Rect square(200, 150, 200, 160);
  image.gray(square).setTo(200);
  image.depth_m(square).setTo(1.0F);
  return image;
}

TEST(SemiDensePoints, LieOnTheOutlineOfWhatIsInFront) {
  const std::vector<Eigen::Vector3f> points = semi_dense_points(square_before_wall(), kCamera, 3000);
  ASSERT_GT(points.size(), 40U);
  for (const Eigen::Vector3f& p : points) {
    EXPECT_FLOAT_EQ(p.z(), 1.0F);
    const double u = 500.0 * static_cast<double>(p.x() / p.z()) + 320.0,
                 v = 500.0 * static_cast<double>(p.y() / p.z()) + 240.0;
    const double outside = std::max({200.0 - u, u - 399.0, 150.0 - v, v - 309.0});
    EXPECT_LT(std::abs(outside), 2.0) << u << ' ' << v;
  }
  EXPECT_EQ(points, semi_dense_points(square_before_wall(), kCamera, 3000));
}

TEST(SemiDensePoints, AreNoMoreThanAskedForEvenOnNoise) {
  RgbdImage image = square_before_wall();
  cv::RNG random(1);
  random.fill(image.gray, cv::RNG::UNIFORM, 0, 255);
  for (const int count : {1, 100, 3000}) {
    const std::size_t points = semi_dense_points(image, kCamera, count).size();
    EXPECT_GT(points, 0U);
    EXPECT_LE(points, static_cast<std::size_t>(1.2 * count) + 2U);
  }
}

TEST(SemiDensePoints, OfBadImagesThereAreNone) {
  RgbdImage image = square_before_wall();
  image.depth_m.setTo(0.0F);
  EXPECT_TRUE(semi_dense_points(image, kCamera, 3000).empty()) << "no depth";
  image = square_before_wall();
  image.gray.setTo(0);
  EXPECT_TRUE(semi_dense_points(image, kCamera, 3000).empty()) << "black";
  image = square_before_wall();
  image.depth_m = image.depth_m(cv::Rect(0, 0, 320, 240));
  EXPECT_TRUE(semi_dense_points(image, kCamera, 3000).empty()) << "depth of another size";
  EXPECT_TRUE(semi_dense_points({}, kCamera, 3000).empty());
}

}  // namespace
}  // namespace semantic_topo_loop::core
