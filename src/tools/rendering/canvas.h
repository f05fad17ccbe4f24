#pragma once

#include <opencv2/core.hpp>

#include "tools/simulation/random.h"

namespace semantic_topo_loop::core {

/// Draws on a picture of a given resolution; lengths in metres.
class Canvas {
 public:
  Canvas(const cv::Size& size, float texels_per_m, const cv::Scalar& background, Random* random);

  /// A rectangle in metres from the upper left corner.
  struct Area {
    double x = 0.0, y = 0.0, width = 0.0, height = 0.0;
  };
  Area all() const;
  void fill(const Area& area, const cv::Scalar& color);
  void frame(const Area& area, double line_m, const cv::Scalar& color);
  void disc(double x, double y, double radius, const cv::Scalar& color);
  void line(double x1, double y1, double x2, double y2, double line_m, const cv::Scalar& color);
  /// Turned rectangles, triangles and discs of random colors and sizes up to `largest_m`.
  void patches(const Area& area, int count, double largest_m);
  /// Rectangles of a board of `cell_m`, each of its own shade.
  void mosaic(const Area& area, double cell_m);
  /// Lines of words.
  void text(const Area& area, double line_m, const cv::Scalar& color);
  /// One of several kinds of pictures with a border.
  void poster(const Area& area);
  /// Brightens and darkens by noise at every scale from the largest cell down to two texels.
  /// @param share of the brightness, standard deviation at each scale
  void roughen(double largest_cell_m, double share);

  cv::Scalar any_color();
  Random& random() { return *random_; }
  const cv::Mat& image() const { return image_; }

 private:
  int px(double m) const;
  cv::Rect rect(const Area& area) const;

  cv::Mat image_;
  double texels_per_m_;
  Random* random_;
};

cv::Scalar shade(const cv::Scalar& color, double factor);

}  // namespace semantic_topo_loop::core
