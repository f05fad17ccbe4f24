#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "tools/rendering/scene_renderer.h"

namespace semantic_topo_loop::core {
namespace {

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();
constexpr float kFar = std::numeric_limits<float>::infinity();
constexpr float kBaseline_m = 0.075F;                    ///< from the camera to the projector, along +x
constexpr float kDisparity_px_m = 580.0F * kBaseline_m;  ///< disparity (px) times range
// Khoshelham and Elberink, Sensors 2012: disparity in eighths of a pixel, f = 580 px.
constexpr float kDisparityNoise_px = 0.05F;
constexpr float kDisparityStep_px = 0.125F;
constexpr float kNear_m = 0.4F;                               ///< nothing is seen nearer
constexpr float kSurelySeen_m = 4.5F, kNeverSeen_m = 6.0F;    ///< between these, ever less
constexpr float kGrazingCosine = 0.10F, kSafeCosine = 0.22F;  ///< of the angle of incidence: no depth, all depth
constexpr float kLostShare = 0.002F;                          ///< of the other pixels, at random
constexpr float kColorNoise = 2.2F;                           ///< grey levels
constexpr float kVignetting = 0.22F;                          ///< lost in the corners

/// Many numbers quickly (xorshift64*, Marsaglia 2003; Vigna 2016), one generator a row.
class FastRandom {
 public:
  FastRandom(std::uint64_t seed, int row) : state_(seed * 0x9e3779b97f4a7c15ULL + static_cast<std::uint64_t>(row)) {
    // Neighbouring seeds part within a few steps of a multiplicative mix.
    for (int i = 0; i < 3; ++i) state_ = (state_ ^ (state_ >> 29)) * 0xbf58476d1ce4e5b9ULL + 1;
    if (state_ == 0) state_ = 1;
  }
  std::uint64_t bits() {
    state_ ^= state_ >> 12;
    state_ ^= state_ << 25;
    state_ ^= state_ >> 27;
    return state_ * 0x2545f4914f6cdd1dULL;
  }
  /// In [0, 1).
  float uniform() { return static_cast<float>(bits() >> 40) * 0x1p-24F; }
  /// Mean 0, standard deviation 1: the sum of four uniform numbers, cut off at 3.5.
  float normal() {
    const std::uint64_t b = bits();
    const auto sum = static_cast<float>((b & 0xffff) + ((b >> 16) & 0xffff) + ((b >> 32) & 0xffff) + (b >> 48));
    return (sum / 65536.0F - 2.0F) * 1.7320508F;
  }

 private:
  std::uint64_t state_;
};

/// Where the projector's light does not fall: a pixel whose column, seen from the projector, is at or right of that of
/// some pixel right of it lies behind that one.
void find_shadows(const cv::Vec2f* rays, const float* depth, std::vector<std::uint8_t>* shadowed) {
  const int width = static_cast<int>(shadowed->size());
  // Neighbours on one slanted surface may change order by rounding, hence a margin of a third of a pixel.
  const float margin = 0.33F * std::abs(rays[width - 1][0] - rays[0][0]) / static_cast<float>(width);
  float leftmost = std::numeric_limits<float>::infinity();
  for (int x = width - 1; x >= 0; --x) {
    const float from_projector = rays[x][0] - kBaseline_m / depth[x];
    (*shadowed)[static_cast<std::size_t>(x)] = from_projector > leftmost + margin ? 1 : 0;
    leftmost = std::min(leftmost, from_projector);
  }
}

float measured(float depth, FastRandom* random) {
  if (random->uniform() < (depth - kSurelySeen_m) / (kNeverSeen_m - kSurelySeen_m)) return kFar;
  const float disparity = kDisparity_px_m / depth + kDisparityNoise_px * random->normal();
  const float step = std::round(disparity / kDisparityStep_px) * kDisparityStep_px;
  return step > 0.0F ? kDisparity_px_m / step : kFar;
}

/// Does this surface return light?
bool returns(float depth, float cosine, FastRandom* random) {
  if (depth < kNear_m || random->uniform() < kLostShare) return false;
  return cosine > kGrazingCosine + (kSafeCosine - kGrazingCosine) * random->uniform();
}

/// -1, 0 or 1, rounded from a normal number of standard deviation 1/2.
int step(float normal) { return normal > 1.0F ? 1 : normal < -1.0F ? -1 : 0; }

}  // namespace

cv::Mat kinect_depth(const RenderedImage& ideal, const PixelRays& rays, std::uint64_t seed) {
  const cv::Size size = ideal.depth_m.size();
  cv::Mat result(size, CV_32FC1);
  std::array<std::vector<std::uint8_t>, 3> shadowed;  // of the rows above, at and below
  const auto shadows_of = [&](int y) -> std::vector<std::uint8_t>& {
    return shadowed[static_cast<std::size_t>(y % 3)];
  };
  const auto prepare = [&](int y) {
    shadows_of(y).resize(static_cast<std::size_t>(size.width));
    find_shadows(rays.rays.ptr<cv::Vec2f>(y), ideal.depth_m.ptr<float>(y), &shadows_of(y));
  };
  prepare(0);
  for (int y = 0; y < size.height; ++y) {
    if (y + 1 < size.height) prepare(y + 1);
    FastRandom random(seed, y);
    float* out = result.ptr<float>(y);
    for (int x = 0; x < size.width; ++x) {
      const int from_y = std::clamp(y + step(random.normal()), 0, size.height - 1);
      const int from_x = std::clamp(x + step(random.normal()), 0, size.width - 1);
      const float depth = ideal.depth_m.at<float>(from_y, from_x);
      const bool seen = shadows_of(from_y)[static_cast<std::size_t>(from_x)] == 0 &&
                        returns(depth, ideal.cosine.at<float>(from_y, from_x), &random);
      out[x] = seen ? measured(depth, &random) : kNone;
    }
  }
  return result;
}

cv::Mat kinect_color(const cv::Mat& ideal, std::uint64_t seed) {
  cv::Mat result;
  cv::GaussianBlur(ideal, result, {3, 3}, 0.6);
  const float half_width = 0.5F * static_cast<float>(ideal.cols), half_height = 0.5F * static_cast<float>(ideal.rows);
  const float corner2 = half_width * half_width + half_height * half_height;
  for (int y = 0; y < result.rows; ++y) {
    FastRandom random(seed, y);
    const float dy = static_cast<float>(y) - half_height;
    std::uint8_t* p = result.ptr(y);
    for (int x = 0; x < result.cols; ++x, p += 3) {
      const float dx = static_cast<float>(x) - half_width;
      const float light = 1.0F - kVignetting * (dx * dx + dy * dy) / corner2;
      for (int i = 0; i < 3; ++i) {
        p[i] = cv::saturate_cast<std::uint8_t>(light * static_cast<float>(p[i]) + kColorNoise * random.normal());
      }
    }
  }
  return result;
}

}  // namespace semantic_topo_loop::core
