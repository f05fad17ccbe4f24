#pragma once

#include <vector>

#include "frontend/depth_registration.h"
#include "frontend/image_features.h"
#include "semantic_topo_loop/frontend/frontend_options.h"
#include "semantic_topo_loop/frontend/rgbd_image.h"

namespace semantic_topo_loop::core {

/// Finds ORB features, spread evenly over the image, with the depth around each.
class FeatureExtractor {
 public:
  /// @param camera, registration must outlive this; may be corrected meanwhile
  FeatureExtractor(const FrontendOptions& options, const Camera& camera, const DepthRegistration& registration)
      : options_(options), camera_(camera), registration_(registration) {}
  ImageFeatures extract(const RgbdImage& image) const;

 private:
  void extract_level(const cv::Mat& image, int level, int wanted, std::vector<cv::Vec2f>* raw_pixels,
                     ImageFeatures* result) const;
  /// Depth around a raw pixel: none where the surroundings, as wide as the registration may be off, are no one surface.
  void measure_depth(const cv::Mat& depth_m, const cv::Vec2f& raw_pixel, ImageFeature* feature) const;

  FrontendOptions options_;
  const Camera& camera_;
  const DepthRegistration& registration_;
};

}  // namespace semantic_topo_loop::core
