#include "tools/rendering/surface_texture.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

namespace semantic_topo_loop::core {
namespace {

using Texel = std::uint32_t;  ///< BGRX

/// Mixes the four bytes two at a time. This is where rendering spends most of its time.
/// @param weight of b, [0, 256]
Texel mix(Texel a, Texel b, Texel weight) {
  constexpr Texel kEven = 0x00ff00ff;
  const Texel even = ((a & kEven) * (256 - weight) + (b & kEven) * weight) >> 8;
  const Texel odd = ((a >> 8) & kEven) * (256 - weight) + ((b >> 8) & kEven) * weight;
  return (even & kEven) | (odd & ~kEven);
}

Texel bilinear(const cv::Mat& image, float u, float v) {
  const float x = std::clamp(u * static_cast<float>(image.cols) - 0.5F, 0.0F, static_cast<float>(image.cols - 1));
  const float y = std::clamp(v * static_cast<float>(image.rows) - 0.5F, 0.0F, static_cast<float>(image.rows - 1));
  const auto x8 = static_cast<int>(256.0F * x), y8 = static_cast<int>(256.0F * y);
  const int x0 = x8 >> 8, y0 = y8 >> 8;
  const int right = x0 + 1 < image.cols ? 1 : 0;
  const Texel* top = image.ptr<Texel>(y0) + x0;
  const Texel* bottom = y0 + 1 < image.rows ? image.ptr<Texel>(y0 + 1) + x0 : top;
  const auto wx = static_cast<Texel>(x8 & 255), wy = static_cast<Texel>(y8 & 255);
  return mix(mix(top[0], top[right], wx), mix(bottom[0], bottom[right], wx), wy);
}

}  // namespace

SurfaceTexture::SurfaceTexture(const cv::Mat& image, float texels_per_m) : texels_per_m_(texels_per_m) {
  cv::Mat four_bytes;
  cv::cvtColor(image, four_bytes, cv::COLOR_BGR2BGRA);
  levels_.push_back(four_bytes);
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
  const auto level8 = static_cast<Texel>(256.0F * level);
  const std::size_t lower = level8 >> 8;
  Texel texel = bilinear(levels_[lower], u, v);
  if ((level8 & 255) != 0) texel = mix(texel, bilinear(levels_[lower + 1], u, v), level8 & 255);
  return {static_cast<float>(texel & 255), static_cast<float>((texel >> 8) & 255),
          static_cast<float>((texel >> 16) & 255)};
}

}  // namespace semantic_topo_loop::core
