#pragma once

#include <opencv2/core.hpp>
#include <vector>

namespace semantic_topo_loop::core {

struct Colour {
  float b = 0.0F, g = 0.0F, r = 0.0F;
};

/// A picture on a flat rectangle with its halvings (mip map), looked up at the size of a pixel's footprint.
class SurfaceTexture {
 public:
  SurfaceTexture() = default;
  /// @param image CV_8UC3, BGR   @param texels_per_m its resolution on the surface
  SurfaceTexture(const cv::Mat& image, float texels_per_m);

  /// @param u,v in [0, 1] across and down the picture   @param footprint_m width of what is averaged
  Colour sample(float u, float v, float footprint_m) const;

 private:
  std::vector<cv::Mat> levels_;  ///< CV_8UC4
  float texels_per_m_ = 1.0F;
};

}  // namespace semantic_topo_loop::core
