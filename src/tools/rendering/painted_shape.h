#pragma once

#include <array>
#include <cstdint>
#include <opencv2/core.hpp>
#include <vector>

#include "tools/rendering/drawn_shape.h"

namespace semantic_topo_loop::core {

struct Color {
  float b = 0.0F, g = 0.0F, r = 0.0F;
};

/// A picture on a flat rectangle with its halvings (mip map), looked up at the size of a pixel's footprint.
class SurfaceTexture {
 public:
  SurfaceTexture() = default;
  /// @param image CV_8UC3, BGR   @param texels_per_m its resolution on the surface
  SurfaceTexture(const cv::Mat& image, float texels_per_m);

  /// @param u,v in [0, 1] across and down the picture   @param footprint_m width of what is averaged
  Color sample(float u, float v, float footprint_m) const;

 private:
  std::vector<cv::Mat> levels_;  ///< CV_8UC4
  float texels_per_m_ = 1.0F;
};

/// A shape with the pictures on its six faces.
class PaintedShape {
 public:
  /// @param inside  the shape is a room: its faces are seen from inside
  PaintedShape(const DrawnShape& shape, bool inside, std::uint64_t seed, std::uint64_t index);

  const DrawnShape& shape() const { return shape_; }
  /// @param p on the surface, in units of `half`, of that face   @param footprint_m width of what a pixel shows
  Color color(const Eigen::Vector3f& p, Face face, float footprint_m) const;

 private:
  DrawnShape shape_;
  bool inside_;
  std::array<SurfaceTexture, kFaces> textures_;
};

}  // namespace semantic_topo_loop::core
