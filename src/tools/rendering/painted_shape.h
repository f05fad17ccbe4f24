#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "tools/rendering/drawn_shape.h"
#include "tools/rendering/surface_painter.h"
#include "tools/rendering/surface_texture.h"

namespace semantic_topo_loop::core {

/// A shape with the pictures on its six faces.
class PaintedShape {
 public:
  /// @param inside  the shape is a room: its faces are seen from inside
  PaintedShape(const DrawnShape& shape, bool inside, std::uint64_t seed, std::uint64_t index);

  const DrawnShape& shape() const { return shape_; }
  /// @param p on the surface, in units of `half`, of that face   @param footprint_m width of what a pixel shows
  Colour colour(const Eigen::Vector3f& p, Face face, float footprint_m) const;

 private:
  DrawnShape shape_;
  bool inside_;
  std::array<SurfaceTexture, kFaces> textures_;
};

}  // namespace semantic_topo_loop::core
