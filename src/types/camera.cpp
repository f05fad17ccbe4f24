#include "semantic_topo_loop/types/camera.h"

#include <algorithm>
#include <cmath>
#include <tuple>

#include "semantic_topo_loop/types/text.h"

namespace semantic_topo_loop::core {
namespace {

/// Displacement that the lens adds to a normalised image point, and its Jacobian.
inline void distort_normalised(const std::array<double, 5>& d, const Vec2& p, Vec2* distorted,
                               Eigen::Matrix2d* jacobian) {
  const double x = p.x(), y = p.y();
  const double r2 = x * x + y * y;
  const double radial = 1.0 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]));
  const double radial_r2 = d[0] + r2 * (2.0 * d[1] + 3.0 * d[4] * r2);
  *distorted << x * radial + 2.0 * d[2] * x * y + d[3] * (r2 + 2.0 * x * x),
      y * radial + d[2] * (r2 + 2.0 * y * y) + 2.0 * d[3] * x * y;
  const double cross = 2.0 * x * y * radial_r2 + 2.0 * d[2] * x + 2.0 * d[3] * y;
  *jacobian << radial + 2.0 * x * x * radial_r2 + 2.0 * d[2] * y + 6.0 * d[3] * x, cross, cross,
      radial + 2.0 * y * y * radial_r2 + 6.0 * d[2] * y + 2.0 * d[3] * x;
}

Vec2 undistort_pixel(const Camera& camera, const Vec2& pixel) {
  const Vec2 target((pixel.x() - camera.cx) / camera.fx, (pixel.y() - camera.cy) / camera.fy);
  Vec2 p = target;
  constexpr int kMaxIterations = 20;  // TUM's lenses take up to 4; the rest is for stronger ones
  for (int i = 0; i < kMaxIterations; ++i) {
    Vec2 distorted;
    Eigen::Matrix2d jacobian;
    distort_normalised(camera.distortion, p, &distorted, &jacobian);
    if (std::abs(jacobian.determinant()) < 1e-6) break;  // outside the lens model's range
    const Vec2 step = jacobian.inverse() * (target - distorted);
    p += step;
    if (step.squaredNorm() < 1e-14) break;  // converges quadratically: the next step would be 1e-14
  }
  return {p.x() * camera.fx + camera.cx, p.y() * camera.fy + camera.cy};
}

}  // namespace

Status Camera::check() const {
  const auto fail = [](const char* field, double value, const char* rule) {
    constexpr int kDigits = 7;
    return Error{std::string(field) + " = " + format_general(value, kDigits) + " " + rule};
  };
  if (!(std::isfinite(fx) && fx > 0.0)) return fail("fx", fx, "must be > 0");
  if (!(std::isfinite(fy) && fy > 0.0)) return fail("fy", fy, "must be > 0");
  if (!std::isfinite(cx)) return fail("cx", cx, "must be finite");
  if (!std::isfinite(cy)) return fail("cy", cy, "must be finite");
  constexpr int kMaxSide_px = 10000;  // no camera has more; what an image needs is set aside before the first one comes
  if (width <= 0 || width > kMaxSide_px) return fail("width", width, "must be in (0, 10000]");
  if (height <= 0 || height > kMaxSide_px) return fail("height", height, "must be in (0, 10000]");
  for (const double value : distortion) {
    if (!std::isfinite(value)) return fail("distortion", value, "must be finite");
  }
  return {};
}

bool Camera::has_distortion() const {
  return std::any_of(distortion.begin(), distortion.end(), [](double value) { return value != 0.0; });
}

Camera Camera::with_focal_lengths_of(const Camera& other) const {
  constexpr double kSameRatio = 1e-9;
  const auto rest = [](const Camera& c) { return std::tie(c.cx, c.cy, c.width, c.height, c.distortion); };
  const bool is_same = rest(*this) == rest(other) && std::abs(other.fx * fy - other.fy * fx) < kSameRatio * fx * fy;
  return is_same ? other : *this;
}

Vec2 Camera::undistort(const Vec2& pixel) const { return has_distortion() ? undistort_pixel(*this, pixel) : pixel; }

Vec2 Camera::distort(const Vec2& pixel) const {
  if (!has_distortion()) return pixel;
  Vec2 distorted;
  Eigen::Matrix2d jacobian;
  distort_normalised(distortion, {(pixel.x() - cx) / fx, (pixel.y() - cy) / fy}, &distorted, &jacobian);
  return {distorted.x() * fx + cx, distorted.y() * fy + cy};
}

Box Camera::undistort(const Box& box) const {
  if (!has_distortion()) return box;
  const Vec2 c = box.center();
  const auto x = [this, &c](double side) { return undistort_pixel(*this, {side, c.y()}).x(); };
  const auto y = [this, &c](double side) { return undistort_pixel(*this, {c.x(), side}).y(); };
  return {x(box.x1), y(box.y1), x(box.x2), y(box.y2)};
}

Box Camera::image() const {
  Box image{0.0, 0.0, static_cast<double>(width), static_cast<double>(height)};
  if (!has_distortion()) return image;
  const Vec2 c = image.center();
  const auto undistorted = [this](const Vec2& pixel, Eigen::Index axis) {
    const Vec2 p = undistort_pixel(*this, pixel);
    return (distort(p) - pixel).norm() < 1.0 ? p(axis) : pixel(axis);
  };
  image.x1 = std::min(image.x1, undistorted({image.x1, c.y()}, 0));
  image.y1 = std::min(image.y1, undistorted({c.x(), image.y1}, 1));
  image.x2 = std::max(image.x2, undistorted({image.x2, c.y()}, 0));
  image.y2 = std::max(image.y2, undistorted({c.x(), image.y2}, 1));
  return image;
}

Mat3 Camera::intrinsics() const {
  Mat3 K;
  K << fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0;
  return K;
}

}  // namespace semantic_topo_loop::core
