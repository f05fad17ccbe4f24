#pragma once

#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <opencv2/core/types.hpp>
#include <vector>

#include "geometry/descriptor.h"
#include "geometry/point_grid.h"
#include "semantic_topo_loop/types/camera.h"

namespace semantic_topo_loop::core {

struct DepthRegistration;
struct FrontendOptions;
struct RgbdImage;

struct ImageFeature {
  Vec2 pixel = Vec2::Zero();  ///< undistorted
  int level = 0;              ///< of the pyramid
  double scale = 1.0;         ///< of the level: its pixels are so many wide, and what it shows is placed as well
  float angle_deg = 0.0F;
  double depth_m = 0.0;  ///< 0: none that can be relied on
  double depth_sigma_m = 0.0;
  bool has_depth() const { return depth_m > 0.0; }
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
  PointGrid grid_;
};

/// FAST corners, spread evenly over the image: the strongest of each of about as many cells as are wanted, then the
/// second strongest, and so on; in the order of the image if there are no more than wanted.
/// @param threshold smallest contrast, grey levels
/// @param strong contrast of those that are looked for first, in a third of the time: weaker ones, of which there are
/// most, then only where there are none. The corners are the same
std::vector<cv::KeyPoint> find_corners(const cv::Mat& image, int threshold, int wanted, int strong = 20);

/// Finds ORB features, spread evenly over the image, with the depth around each.
ImageFeatures extract_features(const RgbdImage& image, const FrontendOptions& options, const Camera& camera,
                               const DepthRegistration& registration);

/// Where something is looked for in an image.
struct SearchItem {
  Descriptor descriptor{};
  Vec2 pixel = Vec2::Zero();
  double radius_px = 0.0;
  int level = 0;            ///< expected; one more or less is accepted
  float angle_deg = -1.0F;  ///< of the feature it was seen at before; < 0: not known
  std::int64_t point = -1;  ///< of the map
};

/// For each item the index of its feature, or -1: the most similar one within the radius, where the second best is
/// clearly less similar, each feature once.
/// @param is_taken features that are out of question
/// @param max_bits largest difference of descriptors   @param ratio best to second best, of about the same level
std::vector<int> search(const std::vector<SearchItem>& items, const ImageFeatures& image,
                        const std::vector<bool>& is_taken, int max_bits, double ratio);

/// For each feature of `a` (only those that are `wanted`) its match in `b`, or -1, up to `max_motion_px` away in x
/// and y: mutually most similar, clearly more than the second best, and turned like most others.
std::vector<int> match_anywhere(const ImageFeatures& a, const std::vector<bool>& wanted, const ImageFeatures& b,
                                double max_motion_px);

}  // namespace semantic_topo_loop::core
