#include "frontend/nearest_depth.h"

#include <algorithm>

#include "geometry/wide_image.h"

namespace semantic_topo_loop::core {

std::optional<Vec2> pixel_in_view(const Camera& camera, const Vec3& p) {
  constexpr double kNearest_m = 0.1;  // what is nearer is a blur in any image
  if (p.z() < kNearest_m) return std::nullopt;
  const Vec2 pixel = camera.pixel(p);
  if (!(pixel.x() >= 0.0 && pixel.y() >= 0.0 && pixel.x() < camera.width && pixel.y() < camera.height)) {
    return std::nullopt;
  }
  return pixel;
}

NearestDepth::NearestDepth(const Camera& camera, const std::vector<Vec3>& points_camera)
    : cell_px_(static_cast<int>(16.0 * pixel_factor(camera))),  // with its neighbours wider than poses are ever off
      columns_(camera.width / cell_px_ + 1),
      rows_(camera.height / cell_px_ + 1),
      nearest_m_(static_cast<std::size_t>(columns_ * rows_)) {
  for (const Vec3& point : points_camera) {
    const std::optional<Vec2> pixel = pixel_in_view(camera, point);
    if (!pixel) continue;
    const int row = static_cast<int>(pixel->y()) / cell_px_, column = static_cast<int>(pixel->x()) / cell_px_;
    float& nearest_m = nearest_m_[static_cast<std::size_t>(row * columns_ + column)];
    const auto z_m = static_cast<float>(point.z());
    if (nearest_m == 0.0F || z_m < nearest_m) nearest_m = z_m;
  }
}

bool NearestDepth::sees_through(const Camera& camera, const Vec3& point_camera) const {
  constexpr double kMargin_m = 0.05, kShare = 0.05;  // of the depth: several sigmas of it, and of the two poses
  const std::optional<Vec2> pixel = pixel_in_view(camera, point_camera);
  if (!pixel || nearest_m_.empty()) return false;
  const int row = static_cast<int>(pixel->y()) / cell_px_, column = static_cast<int>(pixel->x()) / cell_px_;
  // Where there is no depth something may be that gives none.
  float nearest_m = nearest_m_[static_cast<std::size_t>(row * columns_ + column)];
  for (int r = std::max(0, row - 1); r <= std::min(rows_ - 1, row + 1); ++r) {
    for (int c = std::max(0, column - 1); c <= std::min(columns_ - 1, column + 1); ++c) {
      const float z_m = nearest_m_[static_cast<std::size_t>(r * columns_ + c)];
      if (z_m > 0.0F) nearest_m = std::min(nearest_m, z_m);
    }
  }
  return point_camera.z() < (1.0 - kShare) * static_cast<double>(nearest_m) - kMargin_m;
}

}  // namespace semantic_topo_loop::core
