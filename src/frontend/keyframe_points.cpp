#include "semantic_topo_loop/frontend/keyframe_points.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

namespace semantic_topo_loop::core {
namespace {

constexpr int kMinSteepness = 60;       // sum of both Sobel derivatives' magnitudes: about 8 grey levels a pixel
constexpr int kReach = 1;               // pixels around, whose nearest depth is taken
constexpr float kSurfaceShare = 0.05F;  // depths that differ by less are of one surface

/// Of the pixel, or of the nearest surface that begins beside it; 0 if there is none.
float depth_at(const cv::Mat& depth_m, int u, int v) {
  float nearest = 0.0F;
  for (int y = std::max(0, v - kReach); y <= std::min(depth_m.rows - 1, v + kReach); ++y) {
    for (int x = std::max(0, u - kReach); x <= std::min(depth_m.cols - 1, u + kReach); ++x) {
      const float z = depth_m.at<float>(y, x);
      if (z > 0.0F && (nearest == 0.0F || z < nearest)) nearest = z;
    }
  }
  const float own = depth_m.at<float>(v, u);
  return own > 0.0F && own < (1.0F + kSurfaceShare) * nearest ? own : nearest;
}

cv::Mat steepness(const cv::Mat& gray) {
  cv::Mat dx, dy, sum;
  cv::Sobel(gray, dx, CV_16S, 1, 0);
  cv::Sobel(gray, dy, CV_16S, 0, 1);
  cv::add(cv::abs(dx), cv::abs(dy), sum);
  return sum;
}

}  // namespace

std::vector<Eigen::Vector3f> semi_dense_points(const RgbdImage& image, const Camera& camera, int count_max) {
  std::vector<Eigen::Vector3f> points;
  if (image.gray.empty() || image.depth_m.size() != image.gray.size() || count_max < 1) return points;
  const cv::Mat steep = steepness(image.gray);
  const double pixels = static_cast<double>(steep.total());
  const int cell = std::max(1, static_cast<int>(std::ceil(std::sqrt(pixels / count_max))));
  for (int top = 0; top < steep.rows; top += cell) {
    for (int left = 0; left < steep.cols; left += cell) {
      const cv::Rect area = cv::Rect(left, top, cell, cell) & cv::Rect(0, 0, steep.cols, steep.rows);
      double most = 0.0;
      cv::Point at;
      cv::minMaxLoc(steep(area), nullptr, &most, nullptr, &at);
      if (most < kMinSteepness) continue;
      const int u = left + at.x, v = top + at.y;
      const float z = depth_at(image.depth_m, u, v);
      if (!(z > 0.0F)) continue;
      points.push_back((static_cast<double>(z) * camera.ray(camera.undistort(Vec2(u, v)))).cast<float>());
    }
  }
  return points;
}

}  // namespace semantic_topo_loop::core
