#include "surface_texture.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

namespace semantic_topo_loop::core {
namespace {

Colour mix(const Colour& a, const Colour& b, float share) {
  return {a.b + share * (b.b - a.b), a.g + share * (b.g - a.g), a.r + share * (b.r - a.r)};
}

Colour texel(const std::uint8_t* p) {
  return {static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])};
}

Colour bilinear(const cv::Mat& image, float u, float v) {
  const float x = std::clamp(u * static_cast<float>(image.cols) - 0.5F, 0.0F, static_cast<float>(image.cols - 1));
  const float y = std::clamp(v * static_cast<float>(image.rows) - 0.5F, 0.0F, static_cast<float>(image.rows - 1));
  const int x0 = static_cast<int>(x), y0 = static_cast<int>(y);
  const float fx = x - static_cast<float>(x0), fy = y - static_cast<float>(y0);
  const std::uint8_t* top = image.ptr(y0) + 3 * x0;
  const std::uint8_t* bottom = image.ptr(std::min(y0 + 1, image.rows - 1)) + 3 * x0;
  const int right = x0 + 1 < image.cols ? 3 : 0;
  return mix(mix(texel(top), texel(top + right), fx), mix(texel(bottom), texel(bottom + right), fx), fy);
}

}  // namespace

SurfaceTexture::SurfaceTexture(const cv::Mat& image, float texels_per_m) : texels_per_m_(texels_per_m) {
  levels_.push_back(image);
  while (std::max(levels_.back().cols, levels_.back().rows) > 1) {
    const cv::Size half(std::max(1, levels_.back().cols / 2), std::max(1, levels_.back().rows / 2));
    cv::Mat next;
    cv::resize(levels_.back(), next, half, 0.0, 0.0, cv::INTER_AREA);
    levels_.push_back(next);
  }
}

Colour SurfaceTexture::sample(float u, float v, float footprint_m) const {
  const auto top = static_cast<float>(levels_.size() - 1);
  const float level = std::clamp(std::log2(std::max(footprint_m * texels_per_m_, 1.0F)), 0.0F, top);
  const auto lower = static_cast<std::size_t>(level);
  const float share = level - static_cast<float>(lower);
  const Colour fine = bilinear(levels_[lower], u, v);
  return share > 0.0F ? mix(fine, bilinear(levels_[lower + 1], u, v), share) : fine;
}

}  // namespace semantic_topo_loop::core
