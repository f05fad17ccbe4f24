#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "frontend/descriptor.h"
#include "semantic_topo_loop/types/camera.h"

namespace semantic_topo_loop::core {

struct ImageFeature {
  Vec2 pixel = Vec2::Zero();  ///< undistorted
  int level = 0;              ///< of the pyramid
  float angle_deg = 0.0F;
  double depth_m = 0.0;  ///< 0: none that can be relied on
  double depth_sigma_m = 0.0;
  bool has_depth() const { return depth_m > 0.0; }
  /// Standard deviation of the pixel, which is known as well as the level's pixels are small.
  double pixel_sigma(double scale_factor) const { return std::pow(scale_factor, level); }
};

/// The features of one image, and which lie near a pixel.
struct ImageFeatures {
  std::vector<ImageFeature> features;
  std::vector<Descriptor> descriptors;  ///< of the same features

  /// Builds the look-up of `near`; call it once the features are complete.
  void index(const Camera& camera);
  /// Indices, ascending within a cell, of the features within a square around an undistorted pixel.
  void near(const Vec2& pixel, double radius_px, std::vector<int>* found) const;
  std::size_t size() const { return features.size(); }

 private:
  static constexpr int kCell_px = 20;
  int cell_of(double coordinate, int cells) const;
  int columns_ = 0, rows_ = 0;
  std::vector<int> begin_;  ///< of each cell in sorted_, row by row
  std::vector<int> sorted_;
};

}  // namespace semantic_topo_loop::core
