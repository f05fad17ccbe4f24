#include "tools/rendering/painted_shape.h"

#include <algorithm>

namespace semantic_topo_loop::core {
namespace {

/// Enough for the nearest view of each: a pixel at 1 m shows 2 mm.
float texels_per_m(Paint paint) {
  switch (paint) {
    case Paint::kWalls:
      return 250.0F;
    case Paint::kTableTop:
      return 600.0F;
    default:
      return 700.0F;
  }
}

/// Length of a face across and down, m.
Vec2 face_size(Face face, const Vec3& half) {
  if (face == kFront || face == kBack) return {2.0 * half.y(), 2.0 * half.z()};
  if (face == kLeftFace || face == kRightFace) return {2.0 * half.x(), 2.0 * half.z()};
  return {2.0 * half.y(), 2.0 * half.x()};
}

/// Across and down the face as seen from outside, each in [-1, 1].
Eigen::Vector2f face_coordinates(Face face, const Eigen::Vector3f& p) {
  const float scale = 1.0F / p.cwiseAbs().maxCoeff();
  const Eigen::Vector3f q = scale * p;
  switch (face) {
    case kFront:
      return {q.y(), -q.z()};
    case kBack:
      return {-q.y(), -q.z()};
    case kLeftFace:
      return {-q.x(), -q.z()};
    case kRightFace:
      return {q.x(), -q.z()};
    case kTopFace:
      return {q.y(), q.x()};
    default:
      return {q.y(), -q.x()};
  }
}

}  // namespace

PaintedShape::PaintedShape(const DrawnShape& shape, bool inside, std::uint64_t seed, std::uint64_t index)
    : shape_(shape), inside_(inside) {
  Random random(seed, index);
  const cv::Scalar base = base_colour(shape.paint, &random);
  const float resolution = texels_per_m(shape.paint);
  for (int i = 0; i < kFaces; ++i) {
    const auto face = static_cast<Face>(i);
    const Vec2 texels = static_cast<double>(resolution) * face_size(face, shape.half);
    const cv::Size size(std::max(2, static_cast<int>(texels.x())), std::max(2, static_cast<int>(texels.y())));
    textures_[static_cast<std::size_t>(i)] =
        SurfaceTexture(paint_face(shape.paint, face, size, resolution, base, &random), resolution);
  }
}

Colour PaintedShape::colour(const Eigen::Vector3f& p, Face face, float footprint_m) const {
  const Eigen::Vector2f at = face_coordinates(face, p);
  const float across = inside_ ? -at.x() : at.x();
  return textures_[static_cast<std::size_t>(face)].sample(0.5F + 0.5F * across, 0.5F + 0.5F * at.y(), footprint_m);
}

}  // namespace semantic_topo_loop::core
