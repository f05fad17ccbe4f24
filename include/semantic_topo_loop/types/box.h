#pragma once

#include <algorithm>
#include <cmath>

#include "semantic_topo_loop/types/eigen.h"

namespace semantic_topo_loop::core {

/// Axis-aligned image rectangle, pixels, corners (x1, y1) top left and (x2, y2) bottom right.
struct Box {
  double x1 = 0.0, y1 = 0.0, x2 = 0.0, y2 = 0.0;

  double width() const { return x2 - x1; }
  double height() const { return y2 - y1; }
  double area() const { return std::max(0.0, width()) * std::max(0.0, height()); }
  /// Geometric mean of the sides.
  double size() const { return std::sqrt(area()); }
  Vec2 center() const { return {0.5 * (x1 + x2), 0.5 * (y1 + y2)}; }
  Vec4 edges() const { return {x1, y1, x2, y2}; }
  bool is_finite() const { return edges().allFinite(); }
  bool is_valid() const { return is_finite() && x2 > x1 && y2 > y1; }
};

inline double intersection_area(const Box& a, const Box& b) {
  const double w = std::min(a.x2, b.x2) - std::max(a.x1, b.x1);
  const double h = std::min(a.y2, b.y2) - std::max(a.y1, b.y1);
  return w > 0.0 && h > 0.0 ? w * h : 0.0;
}

/// Intersection over union, in [0, 1].
inline double iou(const Box& a, const Box& b) {
  const double intersection = intersection_area(a, b);
  return intersection > 0.0 ? intersection / (a.area() + b.area() - intersection) : 0.0;
}

/// The part of the box inside an image (may be empty).
inline Box clip(const Box& box, const Box& image) {
  return {std::clamp(box.x1, image.x1, image.x2), std::clamp(box.y1, image.y1, image.y2),
          std::clamp(box.x2, image.x1, image.x2), std::clamp(box.y2, image.y1, image.y2)};
}
/// The same for one of the given size.
inline Box clip(const Box& box, double width, double height) { return clip(box, {0.0, 0.0, width, height}); }

/// Which sides of a box touch the image border and therefore do not bound the object.
enum Truncation : std::uint8_t { kLeft = 1, kTop = 2, kRight = 4, kBottom = 8 };

/// @param margin_px distance to the border within which a side counts as cut
inline std::uint8_t truncated_sides(const Box& box, double width, double height, double margin_px) {
  return static_cast<std::uint8_t>((box.x1 <= margin_px ? kLeft : 0) | (box.y1 <= margin_px ? kTop : 0) |
                                   (box.x2 >= width - margin_px ? kRight : 0) |
                                   (box.y2 >= height - margin_px ? kBottom : 0));
}

}  // namespace semantic_topo_loop::core
