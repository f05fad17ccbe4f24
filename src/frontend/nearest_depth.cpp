#include "frontend/nearest_depth.h"

#include <algorithm>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "geometry/wide_image.h"

namespace semantic_topo_loop::core {
namespace {

constexpr float kNone_m = std::numeric_limits<float>::max();

}  // namespace

std::optional<Vec2> pixel_in_view(const Camera& camera, const Vec3& p) {
  constexpr double kNearest_m = 0.1;  // what is nearer is a blur in any image
  if (p.z() < kNearest_m) return std::nullopt;
  const Vec2 pixel = camera.pixel(p);
  const auto is_inside = [&camera](const Vec2& q, double margin) {
    return q.x() >= -margin * camera.width && q.y() >= -margin * camera.height &&
           q.x() < (1.0 + margin) * camera.width && q.y() < (1.0 + margin) * camera.height;
  };
  // At least the raw image's rectangle, as Camera::image. Far beyond it the lens's polynomial may lead back into it.
  constexpr double kBeyond = 0.5;
  const bool is_in_view = is_inside(pixel, 0.0) || (is_inside(pixel, kBeyond) && is_inside(camera.distort(pixel), 0.0));
  return is_in_view ? std::optional(pixel) : std::nullopt;
}

NearestDepth::NearestDepth(const Camera& camera, const std::vector<Vec3>& points_camera)
    : cell_px_(static_cast<int>(16.0 * pixel_factor(camera))) {  // with its neighbours wider than poses are ever off
  cv::Mat1f own(camera.height / cell_px_ + 1, camera.width / cell_px_ + 1, kNone_m);
  for (const Vec3& point : points_camera) {
    const std::optional<Vec2> pixel = pixel_in_view(camera, point);
    if (!pixel) continue;
    float& nearest_m = own(cell(camera, *pixel));
    nearest_m = std::min(nearest_m, static_cast<float>(point.z()));
  }
  cv::erode(own, nearest_m_, cv::Mat());
  // Where there is no depth something may be that gives none.
  nearest_m_.setTo(0.0F, own == kNone_m);
}

bool NearestDepth::sees_through(const Camera& camera, const Vec3& point_camera) const {
  constexpr double kMargin_m = 0.05, kShare = 0.05;  // of the depth: several sigmas of it, and of the two poses
  const std::optional<Vec2> pixel = pixel_in_view(camera, point_camera);
  return pixel && !nearest_m_.empty() &&
         point_camera.z() < (1.0 - kShare) * static_cast<double>(nearest_m_(cell(camera, *pixel))) - kMargin_m;
}

cv::Point NearestDepth::cell(const Camera& camera, const Vec2& pixel) const {
  const int x = std::clamp(static_cast<int>(pixel.x()), 0, camera.width - 1);
  const int y = std::clamp(static_cast<int>(pixel.y()), 0, camera.height - 1);
  return {x / cell_px_, y / cell_px_};
}

}  // namespace semantic_topo_loop::core
