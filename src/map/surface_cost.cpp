#include "map/surface_cost.h"

#include <cmath>

#include "geometry/depth_noise.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

/// Squared closest approach of a ray to the centre, in semi-axes, beyond which its depth is that of the approach.
constexpr double kOutline = 0.81;
constexpr double kBeforeApproach = 1.0 - kOutline;  // squared, so that both depths agree at the outline
constexpr double kInvalidResidual = 20.0;

}  // namespace

std::optional<RayDepth> surface_depth(const Ellipsoid& ellipsoid, const Vec3& origin, const Vec3& direction) {
  // With W = R diag(1/a^2) R' and u = origin - centre, x = origin + t d is on the ellipsoid where A t^2 + 2 B t + C =
  // 0.
  const Mat3 R = ellipsoid.T_world_quadric.rotation();
  const Vec3 inverse_squares = ellipsoid.semi_axes.cwiseAbs2().cwiseInverse();
  const Vec3 u = origin - ellipsoid.center();
  const Vec3 u_axes = R.transpose() * u, d_axes = R.transpose() * direction;
  const Vec3 Wu = R * inverse_squares.cwiseProduct(u_axes), Wd = R * inverse_squares.cwiseProduct(d_axes);
  const double A = direction.dot(Wd), B = u.dot(Wd), C = u.dot(Wu) - 1.0;
  if (!(C > 0.0 && B < 0.0)) return std::nullopt;
  RayDepth result;
  const double discriminant = B * B - A * C;
  if (discriminant > kBeforeApproach * A) {
    result.depth = (-B - std::sqrt(discriminant)) / A;
    const Vec3 x = u + result.depth * direction;
    const Vec3 x_axes = R.transpose() * x, Wx = R * inverse_squares.cwiseProduct(x_axes);
    const double by_depth = direction.dot(Wx);  // half of the derivative of x'Wx
    result.by_center = Wx / by_depth;
    result.by_rotation = x.cross(Wx) / by_depth;
    result.by_log_axes = inverse_squares.cwiseProduct(x_axes.cwiseAbs2()) / by_depth;
    return result;
  }
  const double by_A = B / (A * A) + 0.5 * std::sqrt(kBeforeApproach / A) / A;
  result.depth = -B / A - std::sqrt(kBeforeApproach / A);
  result.by_center = Wd / A;
  result.by_rotation = (u.cross(Wd) + direction.cross(Wu)) / A - 2.0 * by_A * direction.cross(Wd);
  result.by_log_axes =
      inverse_squares.cwiseProduct(2.0 / A * u_axes.cwiseProduct(d_axes) - 2.0 * by_A * d_axes.cwiseAbs2());
  return result;
}

double surface_sigma_m(const BoxView& view, double radius_m, const QuadricFitOptions& options) {
  double depth = 0.0;
  for (const Eigen::Vector3f& p : *view.surface) depth += static_cast<double>(p.z());
  depth /= static_cast<double>(view.surface->size());
  return options.surface_sigma_m + options.surface_share * radius_m + depth_sigma_m(depth);
}

SurfaceCost::SurfaceCost(const BoxView& view, double sigma_m)
    : origin_(view.T_world_camera.t), weight_(1.0 / (sigma_m * std::sqrt(static_cast<double>(view.surface->size())))) {
  for (const Eigen::Vector3f& p : *view.surface) {
    const Vec3 point = p.cast<double>();
    rays_.push_back({view.T_world_camera.q * Vec3(point / point.z()), point.z()});
  }
  set_num_residuals(static_cast<int>(rays_.size()));
  for (const int size : {3, 4, 3}) mutable_parameter_block_sizes()->push_back(size);
}

bool SurfaceCost::Evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  const Eigen::Map<const Vec3> center(parameters[0]);
  const Eigen::Map<const Quaternion> rotation(parameters[1]);
  const Eigen::Map<const Vec3> log_axes(parameters[2]);
  const Ellipsoid ellipsoid{SE3(Quaternion(rotation), Vec3(center)), log_axes.array().exp()};
  const Eigen::Matrix<double, 3, 4> lift = 2.0 * quaternion_by_rotation(Quaternion(rotation)).transpose();
  const auto write = [&](int block, std::size_t row, const auto& value) {
    constexpr Eigen::Index kColumns = std::decay_t<decltype(value)>::ColsAtCompileTime;
    if (jacobians == nullptr || jacobians[block] == nullptr) return;
    Eigen::Map<Eigen::Matrix<double, 1, kColumns>> target(jacobians[block] + kColumns * static_cast<int>(row));
    target = value;
  };
  for (std::size_t i = 0; i < rays_.size(); ++i) {
    const std::optional<RayDepth> surface = surface_depth(ellipsoid, origin_, rays_[i].direction_world);
    const RayDepth s = surface.value_or(RayDepth{});
    residuals[i] = surface ? weight_ * (s.depth - rays_[i].depth) : kInvalidResidual;
    write(0, i, Eigen::RowVector3d(weight_ * s.by_center.transpose()));
    write(1, i, Eigen::Matrix<double, 1, 4>(weight_ * s.by_rotation.transpose() * lift));
    write(2, i, Eigen::RowVector3d(weight_ * s.by_log_axes.transpose()));
  }
  return true;
}

}  // namespace semantic_topo_loop::core
