#pragma once

#include <cmath>
#include <opencv2/imgproc.hpp>

namespace semantic_topo_loop::core::testing {

/// What a camera sees that is rolled about its optical axis, through the image's middle, clockwise as it sees.
inline cv::Mat rolled(const cv::Mat& image, double roll_rad) {
  const double c = std::cos(roll_rad), s = std::sin(roll_rad), x = 0.5 * (image.cols - 1), y = 0.5 * (image.rows - 1);
  const cv::Matx23d turn(c, s, x - c * x - s * y, -s, c, y + s * x - c * y);
  cv::Mat turned;
  cv::warpAffine(image, turned, turn, image.size());
  return turned;
}

}  // namespace semantic_topo_loop::core::testing
