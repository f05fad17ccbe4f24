#include "frontend/depth_registration.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "geometry/wide_image.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kSharp = 0, kBlurred = 1;          ///< indices of Gradients
constexpr std::size_t kRimsPerImage = 500;       ///< about, of each axis: bounds the time of the search
constexpr std::size_t kMinRims = kRimsPerImage;  ///< in all; those of one image hardly tell the five parameters

/// Sigma of the blur, at a width of 640: edges are felt as far as calibrations are wrong, some 10 px.
constexpr double kBlur_px = 4.0;

/// Strength of edges across an axis, cut off where more contrast says no more.
cv::Mat edge_strength(const cv::Mat& gray, int axis) {
  cv::Mat smooth, gradient, magnitude;
  cv::GaussianBlur(gray, smooth, cv::Size(5, 5), 1.2);
  cv::Sobel(smooth, gradient, CV_16S, axis == 0 ? 1 : 0, axis == 0 ? 0 : 1, 3);
  constexpr double kSaturation = 120.0;  // of Sobel's filter: a step of about 50 grey levels
  cv::convertScaleAbs(gradient, magnitude, 255.0 / kSaturation);
  return magnitude;
}

constexpr int kMinSteepness = 60;       // sum of both Sobel derivatives' magnitudes: about 8 grey levels a pixel
constexpr int kReach_px = 1;            // around, whose nearest depth is taken: edges in both images lie that close
constexpr float kSurfaceShare = 0.05F;  // depths that differ by less are of one surface: noise and slope of a pixel

/// Of the pixel, or of the nearest surface that begins beside it; 0 if there is none.
float depth_at(const cv::Mat& depth_m, const Vec2& pixel) {
  const int u = static_cast<int>(std::lround(pixel.x())), v = static_cast<int>(std::lround(pixel.y()));
  if (u < 0 || v < 0 || u >= depth_m.cols || v >= depth_m.rows) return 0.0F;
  float nearest = 0.0F;
  for (int y = std::max(0, v - kReach_px); y <= std::min(depth_m.rows - 1, v + kReach_px); ++y) {
    for (int x = std::max(0, u - kReach_px); x <= std::min(depth_m.cols - 1, u + kReach_px); ++x) {
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

Vec2 DepthRegistration::find_depth(const Camera& camera, const Vec2& pixel_color, const cv::Mat& depth_m) const {
  if (is_identity()) return pixel_color;
  // The place depends on the depth, which is read at the place.
  constexpr int kIterations = 4;  // each error is a hundredth of the one before: the cameras are centimetres apart
  constexpr double kFirstGuess_m = 2.0;  // indoors
  double z_m = kFirstGuess_m;
  Vec2 found = pixel_color;
  for (int i = 0; i < kIterations; ++i) {
    found = to_depth(camera, pixel_color, z_m);
    const int u = static_cast<int>(std::lround(found.x())), v = static_cast<int>(std::lround(found.y()));
    if (u < 0 || v < 0 || u >= depth_m.cols || v >= depth_m.rows) break;
    if (depth_m.at<float>(v, u) > 0.0F) z_m = depth_m.at<float>(v, u);
  }
  return found;
}

std::vector<Eigen::Vector3f> semi_dense_points(const RgbdImage& image, const Camera& camera,
                                               const DepthRegistration& registration, int count_max) {
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
      const Vec2 pixel(left + at.x, top + at.y), there = registration.find_depth(camera, pixel, image.depth_m);
      const float z = depth_at(image.depth_m, there);
      if (!(z > 0.0F)) continue;
      points.push_back((static_cast<double>(z) * camera.ray(camera.undistort(pixel))).cast<float>());
    }
  }
  return points;
}

void RegistrationEstimator::add_rims(const cv::Mat& depth_m, int axis) {
  const double reach_px = 12.0 * pixel_factor(camera_);  // over the shadow beside a surface, in which there is no depth
  constexpr float kStep = 1.15F;  // ratio of the depths: farther apart than any slope's within the reach
  constexpr int kRow = 2;         // every second line
  const int lines = axis == 0 ? depth_m.rows : depth_m.cols, length = axis == 0 ? depth_m.cols : depth_m.rows;
  const auto at = [&](int line, int i) { return axis == 0 ? depth_m.at<float>(line, i) : depth_m.at<float>(i, line); };
  std::vector<Rim> found;
  for (int line = 0; line < lines; line += kRow) {
    int last = -1;  // the last pixel with depth
    for (int i = 0; i < length; ++i) {
      const float z = at(line, i);
      if (z <= 0.0F) continue;
      if (last >= 0 && i - last <= reach_px) {
        const float before = at(line, last);
        const int rim = z > kStep * before ? last : (before > kStep * z ? i : -1);
        if (rim >= 0) {
          const Vec2 pixel = axis == 0 ? Vec2(rim, line) : Vec2(line, rim);
          found.push_back({pixel, at(line, rim), gradients_.size() - 1, axis});
        }
      }
      last = i;
    }
  }
  const std::size_t stride = std::max<std::size_t>(1, found.size() / kRimsPerImage);
  for (std::size_t i = 0; i < found.size(); i += stride) rims_.push_back(found[i]);
}

void RegistrationEstimator::add(const RgbdImage& image) {
  const double blur_px = kBlur_px * pixel_factor(camera_);
  Gradients gradients;
  for (const int axis : {0, 1}) {
    gradients.of_axis[axis][kSharp] = edge_strength(image.gray, axis);
    cv::GaussianBlur(gradients.of_axis[axis][kSharp], gradients.of_axis[axis][kBlurred], cv::Size(0, 0), blur_px);
  }
  gradients_.push_back(gradients);
  add_rims(image.depth_m, 0);
  add_rims(image.depth_m, 1);
}

double RegistrationEstimator::score(const DepthRegistration& registration, const Rim& rim, int blur) const {
  const Vec2 pixel = registration.to_color(camera_, rim.pixel, rim.z_m);
  const auto u = static_cast<int>(std::lround(pixel.x())), v = static_cast<int>(std::lround(pixel.y()));
  if (u < 0 || v < 0 || u >= camera_.width || v >= camera_.height) return 0.0;
  return gradients_[rim.image].of_axis[rim.axis][blur].at<std::uint8_t>(v, u) / 255.0;
}

double RegistrationEstimator::score(const DepthRegistration& registration, int blur) const {
  double sum = 0.0;
  for (const Rim& rim : rims_) sum += score(registration, rim, blur);
  // Shifts beyond those of a camera's housing need reasons.
  constexpr double kShiftSigma_px = 15.0;       // of the optical centres, between two lenses of one kind
  constexpr double kParallaxSigma_px_m = 25.0;  // 5 cm at a focal length of 525 px
  constexpr double kPriorWeight = 0.01;         // a hundredth of the strongest edges a square sigma
  const double factor = pixel_factor(camera_);
  const double prior = (registration.shift_px / (factor * kShiftSigma_px)).squaredNorm() +
                       (registration.parallax_px_m / (factor * kParallaxSigma_px_m)).squaredNorm();
  return sum / static_cast<double>(rims_.size()) - kPriorWeight * prior;
}

DepthRegistration RegistrationEstimator::climb(DepthRegistration best, int blur, double step_px) const {
  constexpr int kRounds = 40;  // 8 px of step in every direction are 320 px: more than any search needs
  const double smallest_px = 0.25 * pixel_factor(camera_);  // outlines are known to no better than twice that
  double highest = score(best, blur);
  const double half_width_px = 0.5 * camera_.width;
  for (int round = 0; round < kRounds && step_px >= smallest_px; ++round) {
    bool is_better = false;
    for (int parameter = 0; parameter < 5; ++parameter) {
      for (const double change : {-step_px, step_px}) {
        DepthRegistration next = best;
        double* const parameters[] = {&next.scale, &next.shift_px.x(), &next.shift_px.y(), &next.parallax_px_m.x(),
                                      &next.parallax_px_m.y()};
        *parameters[parameter] += parameter == 0 ? change / half_width_px : change;  // each moves rims by about as much
        const double value = score(next, blur);
        if (value <= highest) continue;
        highest = value;
        best = next;
        is_better = true;
      }
    }
    if (!is_better) step_px *= 0.5;
  }
  return best;
}

bool RegistrationEstimator::is_clearly_better(const DepthRegistration& registration) const {
  double sum = 0.0, squares = 0.0, moved_px = 0.0;
  const DepthRegistration identity;
  for (const Rim& rim : rims_) {
    const double gain = score(registration, rim, kSharp) - score(identity, rim, kSharp);
    sum += gain;
    squares += gain * gain;
    moved_px += (registration.to_color(camera_, rim.pixel, rim.z_m) - rim.pixel).norm();
  }
  const auto n = static_cast<double>(rims_.size());
  constexpr double kIndependentShare = 0.02;  // one of 50: rims of one outline tell the same
  constexpr double kMinSigmas = 4.0;
  constexpr double kMinGain = 0.03;                          // of the strongest edges
  const double min_motion_px = 3.0 * pixel_factor(camera_);  // registered depth moves by 1 px (fr3_cabinet's)
  const double mean = sum / n;
  const double sigma = std::sqrt(std::max(squares / n - mean * mean, 1e-9) / (kIndependentShare * n));
  return mean > kMinSigmas * sigma && mean > kMinGain && moved_px / n > min_motion_px;
}

bool RegistrationEstimator::has_outlines() const { return rims_.size() >= kMinRims; }

bool RegistrationEstimator::is_telling() const {
  if (!has_outlines()) return false;
  constexpr double kMinContrast = 1.5;  // fr1_xyz's is 2.1, among edges everywhere; that of noise is 1
  double anywhere = 0.0;
  for (const Gradients& gradients : gradients_) {
    for (const auto& of_axis : gradients.of_axis) anywhere += cv::mean(of_axis[kSharp])[0] / 255.0;
  }
  anywhere /= 2.0 * static_cast<double>(gradients_.size());
  return score({}, kSharp) > kMinContrast * anywhere;
}

std::optional<DepthRegistration> RegistrationEstimator::estimate() const {
  if (!has_outlines()) return std::nullopt;
  DepthRegistration best;
  double highest = -1.0;
  // Where a climb ends depends on where it begins. A Kinect's focal lengths, 525 and 585 px, differ by a tenth.
  const double coarse_step_px = 2.0 * kBlur_px * pixel_factor(camera_), fine_step_px = 0.25 * coarse_step_px;
  for (const double scale : {1.0, 0.95, 1.05, 0.9, 1.1}) {
    DepthRegistration start;
    start.scale = scale;
    const DepthRegistration coarse = climb(start, kBlurred, coarse_step_px);
    const double value = score(coarse, kBlurred);
    if (value <= highest) continue;
    highest = value;
    best = coarse;
  }
  best = climb(best, kSharp, fine_step_px);
  if (!is_clearly_better(best)) return std::nullopt;
  return best;
}

}  // namespace semantic_topo_loop::core
