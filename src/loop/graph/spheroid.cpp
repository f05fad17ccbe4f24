#include "loop/graph/spheroid.h"

#include <cmath>

namespace semantic_topo_loop::core {
namespace {

constexpr double kMinDepthSquared = 1e-6;

/// Entry (i, j) of the dual conic with its derivatives by centre, axis and log axes.
struct ConicEntry {
  double value;
  Vec3 d_center = Vec3::Zero();
  Vec3 d_axis = Vec3::Zero();
  Vec2 d_log_axes;
};

ConicEntry conic_entry(int i, int j, const Vec3& c, const Vec3& w, double a2, double b2) {
  ConicEntry entry;
  const double diagonal = i == j ? 1.0 : 0.0;
  const double ww = w(i) * w(j);
  entry.value = a2 * diagonal + (b2 - a2) * ww - c(i) * c(j);
  entry.d_center(i) -= c(j);
  entry.d_center(j) -= c(i);
  entry.d_axis(i) += (b2 - a2) * w(j);
  entry.d_axis(j) += (b2 - a2) * w(i);
  entry.d_log_axes = Vec2(2.0 * a2 * (diagonal - ww), 2.0 * b2 * ww);
  return entry;
}

/// Tangent lines u of C_ii - 2 u C_i2 + u^2 C_22 = 0; f(C_ii, C_i2, C_22) and its gradient.
struct Tangent {
  double u;
  Vec3 gradient;  ///< by C_ii, C_i2, C_22
};

std::optional<Tangent> tangent(double C_ii, double C_i2, double C_22, double sign) {
  const double discriminant = C_i2 * C_i2 - C_ii * C_22;
  if (!(discriminant > 1e-14)) return std::nullopt;
  const double root = std::sqrt(discriminant);
  const double u = (C_i2 + sign * root) / C_22;
  const double d_C_ii = -sign * 0.5 / root;
  const double d_C_i2 = (1.0 + sign * C_i2 / root) / C_22;
  const double d_C_22 = (-sign * 0.5 * C_ii / root - u) / C_22;
  return Tangent{u, Vec3(d_C_ii, d_C_i2, d_C_22)};
}

}  // namespace

std::optional<SpheroidProjection> project_spheroid(const Vec3& c, const Vec3& w, const Vec2& log_axes) {
  const double a2 = std::exp(2.0 * log_axes(0)), b2 = std::exp(2.0 * log_axes(1));
  const ConicEntry C_22 = conic_entry(2, 2, c, w, a2, b2);
  if (!(c.z() > 0.0) || !(C_22.value < -kMinDepthSquared)) return std::nullopt;
  SpheroidProjection projection;
  for (int i = 0; i < 2; ++i) {
    const ConicEntry C_ii = conic_entry(i, i, c, w, a2, b2);
    const ConicEntry C_i2 = conic_entry(i, 2, c, w, a2, b2);
    for (int side = 0; side < 2; ++side) {
      // C_22 < 0, so the smaller tangent has the positive root.
      const auto line = tangent(C_ii.value, C_i2.value, C_22.value, side == 0 ? 1.0 : -1.0);
      if (!line) return std::nullopt;
      const int row = 2 * side + i;
      const Vec3& g = line->gradient;
      projection.edges(row) = line->u;
      projection.d_center.row(row) = (g(0) * C_ii.d_center + g(1) * C_i2.d_center + g(2) * C_22.d_center).transpose();
      projection.d_axis.row(row) = (g(0) * C_ii.d_axis + g(1) * C_i2.d_axis + g(2) * C_22.d_axis).transpose();
      projection.d_log_axes.row(row) =
          (g(0) * C_ii.d_log_axes + g(1) * C_i2.d_log_axes + g(2) * C_22.d_log_axes).transpose();
    }
  }
  return projection;
}

std::optional<Box> spheroid_box(const Vec3& c, const Vec3& w, const Vec2& log_axes) {
  const double a2 = std::exp(2.0 * log_axes(0)), b2 = std::exp(2.0 * log_axes(1));
  const double C_22 = a2 + (b2 - a2) * w.z() * w.z() - c.z() * c.z();
  if (!(c.z() > 0.0) || !(C_22 < -kMinDepthSquared)) return std::nullopt;
  double edges[4];
  for (int i = 0; i < 2; ++i) {
    const double C_ii = a2 + (b2 - a2) * w(i) * w(i) - c(i) * c(i);
    const double C_i2 = (b2 - a2) * w(i) * w.z() - c(i) * c.z();
    const double discriminant = C_i2 * C_i2 - C_ii * C_22;
    if (!(discriminant > 0.0)) return std::nullopt;
    const double root = std::sqrt(discriminant);
    edges[i] = (C_i2 + root) / C_22;
    edges[2 + i] = (C_i2 - root) / C_22;
  }
  return Box{edges[0], edges[1], edges[2], edges[3]};
}

}  // namespace semantic_topo_loop::core
