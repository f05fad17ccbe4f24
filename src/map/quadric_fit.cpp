#include "map/quadric_fit.h"

#include <ceres/ceres.h>
#include <ceres/normal_prior.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <deque>

#include "geometry/ceres_compat.h"
#include "geometry/statistics.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/geometry/quadric.h"

namespace semantic_topo_loop::core {
namespace {

/// Squared closest approach of a ray to the centre, in semi-axes, beyond which its depth is that of the approach.
constexpr double kOutline = 0.81;
constexpr double kBeforeApproach = 1.0 - kOutline;  // squared, so that both depths agree at the outline

constexpr double kInvalidResidual = 20.0;  // far outside the noise: no view may vanish to lower the cost

/// r = (projected edges - detected edges) / sigma over centre, rotation (Eigen quaternion) and log semi-axes.
class BoxEdgeCost final : public ceres::SizedCostFunction<4, 3, 4, 3> {
 public:
  BoxEdgeCost(const Mat34& P_image_world, const BoxView& view, double sigma)
      : P_(P_image_world), edges_(view.box.edges()) {
    for (int i = 0; i < 4; ++i) weights_(i) = (view.truncated & (1 << i)) != 0 ? 0.0 : 1.0 / sigma;
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const Eigen::Map<const Vec3> center(parameters[0]);
    const Eigen::Map<const Quaternion> rotation(parameters[1]);
    const Eigen::Map<const Vec3> log_axes(parameters[2]);
    const Ellipsoid ellipsoid{SE3(Quaternion(rotation), Vec3(center)), log_axes.array().exp()};
    BoxJacobian J;
    const std::optional<Box> box = project_box(ellipsoid, P_, jacobians != nullptr ? &J : nullptr);
    Eigen::Map<Vec4> r(residuals);
    r = box ? Vec4(weights_.cwiseProduct(box->edges() - edges_))
            : Vec4((weights_.array() > 0.0).select(kInvalidResidual, Vec4::Zero()));
    if (jacobians == nullptr) return true;
    if (!box)
      J = {Eigen::Matrix<double, 4, 3>::Zero(), Eigen::Matrix<double, 4, 3>::Zero(),
           Eigen::Matrix<double, 4, 3>::Zero()};
    const auto write = [](double* target, const auto& value) {
      using Value = typename std::decay_t<decltype(value)>;
      Eigen::Map<Eigen::Matrix<double, 4, Value::ColsAtCompileTime, Eigen::RowMajor>> map(target);
      map = value;
    };
    if (jacobians[0] != nullptr) write(jacobians[0], (weights_.asDiagonal() * J.center).eval());
    if (jacobians[1] != nullptr) {
      const Eigen::Matrix<double, 4, 3> plus = quaternion_by_rotation(Quaternion(rotation));
      write(jacobians[1], (weights_.asDiagonal() * (2.0 * J.rotation) * plus.transpose()).eval());
    }
    if (jacobians[2] != nullptr) write(jacobians[2], (weights_.asDiagonal() * J.log_axes).eval());
    return true;
  }

 private:
  Mat34 P_;
  Vec4 edges_;
  Vec4 weights_;
};

/// r = (depth of the ellipsoid - measured depth) / (sigma sqrt(number of points)) over centre, rotation (Eigen
/// quaternion) and log semi-axes.
class SurfaceCost final : public ceres::CostFunction {
 public:
  /// @param view has a surface
  SurfaceCost(const BoxView& view, double sigma_m)
      : origin_(view.T_world_camera.t),
        weight_(1.0 / (sigma_m * std::sqrt(static_cast<double>(view.surface->size())))) {
    for (const Eigen::Vector3f& p : *view.surface) {
      const Vec3 point = p.cast<double>();
      rays_.push_back({view.T_world_camera.q * Vec3(point / point.z()), point.z()});
    }
    set_num_residuals(static_cast<int>(rays_.size()));
    for (const int size : {3, 4, 3}) mutable_parameter_block_sizes()->push_back(size);
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const Eigen::Map<const Vec3> center(parameters[0]);
    const Eigen::Map<const Quaternion> rotation(parameters[1]);
    const Eigen::Map<const Vec3> log_axes(parameters[2]);
    const Ellipsoid ellipsoid{SE3(Quaternion(rotation), Vec3(center)), log_axes.array().exp()};
    const Eigen::Matrix<double, 3, 4> lift = 2.0 * quaternion_by_rotation(Quaternion(rotation)).transpose();
    const auto write = [&](int block, std::size_t row, const auto& value) {
      constexpr int kColumns = std::decay_t<decltype(value)>::ColsAtCompileTime;
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

 private:
  struct Ray {
    Vec3 direction_world;  ///< depth 1
    double depth;          ///< measured, m
  };
  Vec3 origin_;
  std::vector<Ray> rays_;
  double weight_;
};

/// Standard deviation of one view's depth against an ellipsoid of the given radius.
double surface_sigma_m(const BoxView& view, double radius_m, const QuadricFitOptions& options) {
  double depth = 0.0;
  for (const Eigen::Vector3f& p : *view.surface) depth += static_cast<double>(p.z());
  depth /= static_cast<double>(view.surface->size());
  return options.surface_sigma_m + options.surface_share * radius_m + depth_sigma_m(depth);
}

/// Covariance of the centre from the weighted normal matrix of box edges and depth, rotation held fixed.
Mat3 center_covariance(const std::vector<Mat34>& projections, const std::vector<BoxView>& views,
                       const std::vector<double>& sigmas, const std::vector<double>& surface_sigmas,
                       const Ellipsoid& ellipsoid) {
  Mat6 H = 1e-9 * Mat6::Identity();
  for (std::size_t i = 0; i < views.size(); ++i) {
    BoxJacobian J;
    if (!project_box(ellipsoid, projections[i], &J)) continue;
    for (int k = 0; k < 4; ++k) {
      if ((views[i].truncated & (1 << k)) != 0) continue;
      Vec6 row;
      row << J.center.row(k).transpose(), J.log_axes.row(k).transpose();
      H += row * row.transpose() / (sigmas[i] * sigmas[i]);
    }
    if (!views[i].surface) continue;
    const double n = static_cast<double>(views[i].surface->size());
    for (const Eigen::Vector3f& p : *views[i].surface) {
      const Vec3 ray = views[i].T_world_camera.q * Vec3(p.cast<double>() / static_cast<double>(p.z()));
      const std::optional<RayDepth> depth = surface_depth(ellipsoid, views[i].T_world_camera.t, ray);
      if (!depth) continue;
      Vec6 row;
      row << depth->by_center, depth->by_log_axes;
      H += row * row.transpose() / (n * surface_sigmas[i] * surface_sigmas[i]);
    }
  }
  H.bottomRightCorner<3, 3>() += Mat3::Identity();  // log axes are known to about e^1 in any case
  return Mat6(H.inverse()).topLeftCorner<3, 3>();
}

}  // namespace

std::optional<QuadricFit> refine_quadric(const Camera& camera, const std::vector<BoxView>& views,
                                         const Ellipsoid& initial, const QuadricFitOptions& options) {
  if (views.empty() || !initial.T_world_quadric.is_finite() || !(initial.semi_axes.minCoeff() > 0.0))
    return std::nullopt;
  std::vector<Mat34> projections;
  std::vector<double> sigmas, surface_sigmas;
  std::deque<BoxEdgeCost> costs;  // cost functions cannot be moved
  std::deque<SurfaceCost> surface_costs;
  for (const BoxView& view : views) {
    projections.push_back(projection_matrix(camera, view.T_world_camera));
    sigmas.push_back(options.sigma_px + options.sigma_share * view.box.size());
    costs.emplace_back(projections.back(), view, sigmas.back());
    surface_sigmas.push_back(view.surface ? surface_sigma_m(view, initial.radius(), options) : 0.0);
    if (view.surface) surface_costs.emplace_back(view, surface_sigmas.back());
  }
  Vec3 center = initial.center();
  Quaternion rotation = initial.T_world_quadric.q;
  Vec3 log_axes = initial.semi_axes.array().log();
  // Keeps axes that no view bounds near a sphere.
  const double roundness_weight = std::sqrt(options.roundness_weight * static_cast<double>(views.size()));
  ceres::NormalPrior roundness(roundness_weight * Mat3::Identity(), Vec3::Constant(log_axes.mean()));
  ceres::SoftLOneLoss loss(1.0);
  ceres::CauchyLoss surface_loss(1.0);  // what was taken for the object may be all of it something else

  ceres::Problem::Options problem_options;
  problem_options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.disable_all_safety_checks = true;
  ceres::Problem problem(problem_options);
  problem.AddParameterBlock(rotation.coeffs().data(), 4);
  set_quaternion_manifold(problem, rotation.coeffs().data());
  for (BoxEdgeCost& cost : costs) {
    problem.AddResidualBlock(&cost, &loss, center.data(), rotation.coeffs().data(), log_axes.data());
  }
  for (SurfaceCost& cost : surface_costs) {
    problem.AddResidualBlock(&cost, &surface_loss, center.data(), rotation.coeffs().data(), log_axes.data());
  }
  problem.AddResidualBlock(&roundness, nullptr, log_axes.data());

  ceres::Solver::Options solver_options;
  solver_options.num_threads = 1;
  solver_options.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;
  solver_options.max_num_iterations = options.max_iterations;
  solver_options.function_tolerance = 1e-4;
  solver_options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(solver_options, &problem, &summary);
  if (!summary.IsSolutionUsable()) return std::nullopt;

  QuadricFit fit;
  fit.ellipsoid = {SE3(rotation.normalized(), center), log_axes.array().exp()};
  if (!fit.ellipsoid.T_world_quadric.is_finite() || !fit.ellipsoid.semi_axes.allFinite()) return std::nullopt;
  std::vector<double> depths;
  depths.reserve(views.size());
  for (const BoxView& view : views) depths.push_back(view.depth(center));
  fit.median_depth_m = median(std::move(depths));
  const Mat3 shape = fit.ellipsoid.shape();
  for (std::size_t i = 0; i < views.size(); ++i) {
    const std::optional<Box> box = project_box(center, shape, projections[i]);
    if (box)
      fit.mean_iou += iou(clip(*box, camera.width, camera.height), clip(views[i].box, camera.width, camera.height));
  }
  fit.mean_iou /= static_cast<double>(views.size());
  fit.center_covariance = center_covariance(projections, views, sigmas, surface_sigmas, fit.ellipsoid);
  return fit;
}

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

}  // namespace semantic_topo_loop::core
