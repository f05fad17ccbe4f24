#pragma once

#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "semantic_topo_loop/frontend/rgbd_image.h"

namespace semantic_topo_loop::core {

/// Where a color image shows what a depth image shows, for depth that is not registered to it: the two cameras look
/// the same way from places beside each other, with focal lengths of their own.
///   pixel_color = c + scale (pixel_depth - c) + shift_px + parallax_px_m / z
struct DepthRegistration {
  double scale = 1.0;
  Vec2 shift_px = Vec2::Zero();
  Vec2 parallax_px_m = Vec2::Zero();  ///< focal length times baseline

  bool is_identity() const { return scale == 1.0 && shift_px.isZero(0.0) && parallax_px_m.isZero(0.0); }
  Vec2 to_color(const Camera& camera, const Vec2& pixel_depth, double z_m) const {
    const Vec2 c(camera.cx, camera.cy);
    return c + scale * (pixel_depth - c) + shift_px + parallax_px_m / z_m;
  }
  Vec2 to_depth(const Camera& camera, const Vec2& pixel_color, double z_m) const {
    const Vec2 c(camera.cx, camera.cy);
    return c + (pixel_color - c - shift_px - parallax_px_m / z_m) / scale;
  }
  /// The pixel of the depth image that shows what a pixel of the color image shows; it may lie outside.
  Vec2 find_depth(const Camera& camera, const Vec2& pixel_color, const cv::Mat& depth_m) const;
};

/// Points on the edges of an image: in each cell of an even grid the pixel of the steepest grey level, if it is steep
/// and has a depth. Where depth jumps, the nearer side is taken: an outline belongs to what is in front.
/// @param count_max about so many at most, by the size of the cells   @return camera frame, m, row by row
std::vector<Eigen::Vector3f> semi_dense_points(const RgbdImage& image, const Camera& camera,
                                               const DepthRegistration& registration, int count_max);

/// Finds the registration from images: outlines in depth should lie on edges in color.
class RegistrationEstimator {
 public:
  explicit RegistrationEstimator(const Camera& camera) : camera_(camera) {}

  void add(const RgbdImage& image);
  int images() const { return static_cast<int>(gradients_.size()); }
  /// Whether there is more to see in color where depth has outlines than elsewhere. In the dark, or blurred, there is
  /// not: that nothing was found says nothing then.
  bool is_telling() const;
  /// @return the registration, if it differs from the identity and explains the images clearly better
  std::optional<DepthRegistration> estimate() const;

 private:
  bool has_outlines() const;
  /// A pixel at the rim of a surface that hides another one.
  struct Rim {
    Vec2 pixel = Vec2::Zero();
    double z_m = 0.0;
    std::size_t image = 0;
    int axis = 0;  ///< along which depth jumps: 0 x, 1 y
  };
  void add_rims(const cv::Mat& depth_m, int axis);
  double score(const DepthRegistration& registration, const Rim& rim, int blur) const;
  double score(const DepthRegistration& registration, int blur) const;
  DepthRegistration climb(DepthRegistration start, int blur, double step_px) const;
  bool is_clearly_better(const DepthRegistration& registration) const;

  Camera camera_;
  /// Strength of the edges across x and across y, sharp and blurred, of each image; CV_8UC1.
  struct Gradients {
    cv::Mat of_axis[2][2];
  };
  std::vector<Gradients> gradients_;
  std::vector<Rim> rims_;
};

}  // namespace semantic_topo_loop::core
