#include "frontend/feature_extractor.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>

#include "geometry/depth_points.h"

namespace semantic_topo_loop::core {
namespace {

// ORB (Rublee, Rabaud, Konolige and Bradski 2011).
constexpr int kPatchRadius_px = 15;  ///< of orientation and descriptor
constexpr int kBorder_px = 19;       ///< a descriptor's pairs of pixels lie within +-13 px, turned within 13 sqrt(2)
constexpr int kFastRadius_px = 3;    ///< of the circle that a corner is found by

/// Half width of each row of the round patch.
std::array<int, kPatchRadius_px + 1> circle_rows() {
  std::array<int, kPatchRadius_px + 1> half_width{};
  for (int v = 0; v <= kPatchRadius_px; ++v) {
    half_width[static_cast<std::size_t>(v)] =
        static_cast<int>(std::floor(std::sqrt(kPatchRadius_px * kPatchRadius_px - v * v)));
  }
  return half_width;
}

/// Direction from the corner to the centroid of its patch's brightness.
float orientation_deg(const cv::Mat& image, int x, int y) {
  static const std::array<int, kPatchRadius_px + 1> half_width = circle_rows();
  int m10 = 0, m01 = 0;
  for (int v = -kPatchRadius_px; v <= kPatchRadius_px; ++v) {
    const std::uint8_t* row = image.ptr<std::uint8_t>(y + v) + x;
    const int half = half_width[static_cast<std::size_t>(std::abs(v))];
    int sum = 0;
    for (int u = -half; u <= half; ++u) {
      m10 += u * row[u];
      sum += row[u];
    }
    m01 += v * sum;
  }
  return cv::fastAtan2(static_cast<float>(m01), static_cast<float>(m10));
}

/// The strongest corner of each cell, then the second strongest, and so on, until enough are chosen: even over the
/// image, and the best where there is much to choose from.
std::vector<cv::KeyPoint> spread(std::vector<cv::KeyPoint> corners, const cv::Size& size, int wanted) {
  if (static_cast<int>(corners.size()) <= wanted) return corners;
  const double cell_px = std::max(1.0, std::sqrt(static_cast<double>(size.area()) / wanted));
  const int columns = static_cast<int>(size.width / cell_px) + 1, rows = static_cast<int>(size.height / cell_px) + 1;
  std::stable_sort(corners.begin(), corners.end(),
                   [](const cv::KeyPoint& a, const cv::KeyPoint& b) { return a.response > b.response; });
  std::vector<int> taken(static_cast<std::size_t>(columns * rows), 0);
  for (cv::KeyPoint& corner : corners) {
    const auto cell = static_cast<std::size_t>(static_cast<int>(corner.pt.y / cell_px) * columns +
                                               static_cast<int>(corner.pt.x / cell_px));
    corner.class_id = taken[cell]++;
  }
  std::stable_sort(corners.begin(), corners.end(),
                   [](const cv::KeyPoint& a, const cv::KeyPoint& b) { return a.class_id < b.class_id; });
  corners.resize(static_cast<std::size_t>(wanted));
  return corners;
}

}  // namespace

void FeatureExtractor::extract_level(const cv::Mat& image, int level, int wanted, std::vector<cv::Vec2f>* raw_pixels,
                                     ImageFeatures* result) const {
  // Sizes are whole numbers, so that the two axes are not scaled by exactly the same.
  const double scale_x = static_cast<double>(camera_.width) / image.cols;
  const double scale_y = static_cast<double>(camera_.height) / image.rows;
  if (image.cols <= 2 * kBorder_px || image.rows <= 2 * kBorder_px) return;
  const int margin = kBorder_px - kFastRadius_px;
  const cv::Rect inner(margin, margin, image.cols - 2 * margin, image.rows - 2 * margin);
  std::vector<cv::KeyPoint> corners;
  cv::FAST(image(inner), corners, options_.corner_threshold, true);
  corners = spread(std::move(corners), inner.size(), wanted);
  for (cv::KeyPoint& corner : corners) {
    corner.pt.x += static_cast<float>(margin);
    corner.pt.y += static_cast<float>(margin);
    corner.angle = orientation_deg(image, static_cast<int>(corner.pt.x), static_cast<int>(corner.pt.y));
    corner.octave = 0;
  }
  // One level, no border of its own: every corner keeps its place in the list.
  const cv::Ptr<cv::ORB> orb = cv::ORB::create(wanted, 1.2F, 1, 0, 0, 2, cv::ORB::FAST_SCORE);
  cv::Mat descriptors;
  orb->compute(image, corners, descriptors);
  for (std::size_t i = 0; i < corners.size(); ++i) {
    // Pixel centres are whole numbers, so that half a pixel is moved before and after scaling.
    const cv::Vec2f raw(static_cast<float>((corners[i].pt.x + 0.5) * scale_x - 0.5),
                        static_cast<float>((corners[i].pt.y + 0.5) * scale_y - 0.5));
    ImageFeature feature;
    feature.pixel = camera_.undistort(Vec2(raw[0], raw[1]));
    feature.level = level;
    feature.angle_deg = corners[i].angle;
    Descriptor descriptor;
    std::memcpy(descriptor.data(), descriptors.ptr(static_cast<int>(i)), sizeof(descriptor));
    raw_pixels->push_back(raw);
    result->features.push_back(feature);
    result->descriptors.push_back(descriptor);
  }
}

void FeatureExtractor::measure_depth(const cv::Mat& depth_m, const cv::Vec2f& raw_pixel, ImageFeature* feature) const {
  constexpr int kMinValues = 13;        // half of the grid
  constexpr double kStepShare = 0.06;   // of the depth: 8 px wide, a slope of more than 75 deg, or a step
  constexpr double kRounding_m = 1e-3;  // of depth in whole millimetres, and what calibration leaves
  constexpr double kNoiseRange = 4.0;   // the range of 25 values is four sigmas
  constexpr double kSlopeShare = 0.25;  // sigma of a uniform distribution over the range: 1 / sqrt(12), and a bit less
  const int reach = std::max(options_.registration_px, 1);
  const Vec2 center = registration_.find_depth(camera_, Vec2(raw_pixel[0], raw_pixel[1]), depth_m);
  const int u0 = static_cast<int>(std::lround(center.x())), v0 = static_cast<int>(std::lround(center.y()));
  std::array<float, 25> values{};
  std::size_t count = 0;
  for (int row = -2; row <= 2; ++row) {
    for (int column = -2; column <= 2; ++column) {
      const int u = u0 + column * reach / 2, v = v0 + row * reach / 2;
      if (u < 0 || v < 0 || u >= depth_m.cols || v >= depth_m.rows) continue;
      const float z = depth_m.at<float>(v, u);
      if (z > 0.0F) values[count++] = z;
    }
  }
  if (count < kMinValues) return;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(count / 2);
  std::nth_element(values.begin(), middle, values.begin() + static_cast<std::ptrdiff_t>(count));
  const double z = *middle;
  const auto [lowest, highest] =
      std::minmax_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(count));
  const double spread_m = *highest - *lowest;
  const double noise_m = depth_sigma_m(z) + kRounding_m;
  if (spread_m > kStepShare * z + kNoiseRange * noise_m) return;
  const double slope_m = kSlopeShare * std::max(0.0, spread_m - kNoiseRange * noise_m);
  feature->depth_m = z;
  feature->depth_sigma_m = std::hypot(noise_m, slope_m);
}

ImageFeatures FeatureExtractor::extract(const RgbdImage& image) const {
  ImageFeatures result;
  std::vector<cv::Vec2f> raw_pixels;
  const double ratio = 1.0 / options_.scale_factor;
  double share = (1.0 - ratio) / (1.0 - std::pow(ratio, options_.levels));
  cv::Mat level_image = image.gray;
  for (int level = 0; level < options_.levels; ++level) {
    if (level > 0) {
      const double scale = std::pow(options_.scale_factor, level);
      const cv::Size size(static_cast<int>(std::lround(image.gray.cols / scale)),
                          static_cast<int>(std::lround(image.gray.rows / scale)));
      if (size.width <= 2 * kBorder_px || size.height <= 2 * kBorder_px) break;
      cv::Mat smaller;
      cv::resize(level_image, smaller, size, 0.0, 0.0, cv::INTER_LINEAR);
      level_image = smaller;
    }
    extract_level(level_image, level, static_cast<int>(std::lround(options_.features * share)), &raw_pixels, &result);
    share *= ratio;
  }
  for (std::size_t i = 0; i < result.size(); ++i) measure_depth(image.depth_m, raw_pixels[i], &result.features[i]);
  result.index(camera_);
  return result;
}

}  // namespace semantic_topo_loop::core
