#include "map/quadric_fit.h"

#include <ceres/ceres.h>
#include <ceres/normal_prior.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <deque>

#include "geometry/ceres_compat.h"
#include "geometry/depth_points.h"
#include "geometry/statistics.h"
#include "geometry/wide_image.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/geometry/quadric.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kInvalidResidual = 20.0;  // far outside the noise: no view may vanish to lower the cost

/// r = (projected edges - detected edges) / sigma over centre, rotation (Eigen quaternion) and log semi-axes.
class BoxEdgeCost final : public ceres::SizedCostFunction<4, 3, 4, 3> {
 public:
  BoxEdgeCost(const Mat34& P_image_world, const BoxView& view, double sigma)
      : P_(P_image_world), edges_(view.box.edges()) {
    for (int i = 0; i < 4; ++i) {
      const bool is_cut = (view.truncated & (1 << i)) != 0;
      weights_(i) = is_cut && !(view.near_m > 0.0) ? 0.0 : 1.0 / sigma;
      is_least_[static_cast<std::size_t>(i)] = is_cut;
    }
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const Eigen::Map<const Vec3> center(parameters[0]);
    const Eigen::Map<const Quaternion> rotation(parameters[1]);
    const Eigen::Map<const Vec3> log_axes(parameters[2]);
    const Ellipsoid ellipsoid{SE3(Quaternion(rotation), Vec3(center)), log_axes.array().exp()};
    BoxJacobian J;
    const std::optional<Box> box = project_box(ellipsoid, P_, jacobians != nullptr ? &J : nullptr);
    Eigen::Map<Vec4> r(residuals);
    Vec4 weights = weights_;
    for (Eigen::Index i = 0; box && i < 4; ++i) {
      const double beyond = (i < 2 ? -1.0 : 1.0) * (box->edges()(i) - edges_(i));
      if (is_least_[static_cast<std::size_t>(i)] && beyond > 0.0) weights(i) = 0.0;
    }
    r = box ? Vec4(weights.cwiseProduct(box->edges() - edges_))
            : Vec4((weights.array() > 0.0).select(kInvalidResidual, Vec4::Zero()));
    if (jacobians == nullptr) return true;
    if (!box)
      J = {Eigen::Matrix<double, 4, 3>::Zero(), Eigen::Matrix<double, 4, 3>::Zero(),
           Eigen::Matrix<double, 4, 3>::Zero()};
    const auto write = [](double* target, const auto& value) {
      using Value = typename std::decay_t<decltype(value)>;
      Eigen::Map<Eigen::Matrix<double, 4, Value::ColsAtCompileTime, Eigen::RowMajor>> map(target);
      map = value;
    };
    if (jacobians[0] != nullptr) write(jacobians[0], (weights.asDiagonal() * J.center).eval());
    if (jacobians[1] != nullptr) {
      const Eigen::Matrix<double, 4, 3> plus = quaternion_by_rotation(Quaternion(rotation));
      write(jacobians[1], (weights.asDiagonal() * (2.0 * J.rotation) * plus.transpose()).eval());
    }
    if (jacobians[2] != nullptr) write(jacobians[2], (weights.asDiagonal() * J.log_axes).eval());
    return true;
  }

 private:
  Mat34 P_;
  Vec4 edges_;
  Vec4 weights_;
  std::array<bool, 4> is_least_{};  ///< the side is cut there: the object reaches so far or farther
};

/// r = (depth of the centre - near_side_m of the smallest semi-axis - depth of the near side) / sigma over centre and
/// log semi-axes.
class NearSideCost final : public ceres::SizedCostFunction<1, 3, 3> {
 public:
  NearSideCost(const BoxView& view, double sigma_m)
      : origin_(view.T_world_camera.t),
        axis_(view.T_world_camera.q * Vec3::UnitZ()),
        near_m_(view.near_m),
        weight_(1.0 / sigma_m) {}

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const Eigen::Map<const Vec3> center(parameters[0]), log_axes(parameters[1]);
    Eigen::Index smallest = 0;
    const double thickness = std::exp(log_axes.minCoeff(&smallest));
    const double before = near_side_m(thickness);
    residuals[0] = weight_ * (axis_.dot(center - origin_) - before - near_m_);
    if (jacobians == nullptr) return true;
    const std::array<Vec3, 2> by{weight_ * axis_,
                                 (thickness < kThickest_m ? -weight_ * before : 0.0) * Vec3::Unit(smallest)};
    for (std::size_t i = 0; i < 2; ++i) {
      if (jacobians[i] != nullptr) std::copy_n(by[i].data(), 3, jacobians[i]);
    }
    return true;
  }

 private:
  Vec3 origin_, axis_;
  double near_m_, weight_;
};

/// Standard deviation of a view's near side against an ellipsoid of the given radius.
double near_sigma_m(const BoxView& view, double radius_m, const QuadricFitOptions& options) {
  const double share = view.truncated != 0 ? options.near_share_cut : options.near_share;
  return options.near_sigma_m + share * radius_m + depth_sigma_m(view.near_m);
}

/// Covariance of the centre from the weighted normal matrix of box edges and depth, rotation held fixed.
Mat3 center_covariance(const std::vector<Mat34>& projections, const std::vector<BoxView>& views,
                       const std::vector<double>& sigmas, const std::vector<double>& near_sigmas,
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
    if (!(views[i].near_m > 0.0)) continue;
    Vec6 row = Vec6::Zero();
    row.head<3>() = views[i].T_world_camera.q * Vec3::UnitZ();
    Eigen::Index smallest = 0;
    const double thickness = ellipsoid.semi_axes.minCoeff(&smallest);
    row(3 + smallest) = thickness < kThickest_m ? -near_side_m(thickness) : 0.0;
    H += row * row.transpose() / (near_sigmas[i] * near_sigmas[i]);
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
  std::vector<double> sigmas, near_sigmas;
  std::deque<BoxEdgeCost> costs;  // cost functions cannot be moved
  std::deque<NearSideCost> near_costs;
  for (const BoxView& view : views) {
    projections.push_back(projection_matrix(camera, view.T_world_camera));
    sigmas.push_back(pixel_factor(camera) * options.sigma_px + options.sigma_share * view.box.size());
    costs.emplace_back(projections.back(), view, sigmas.back());
    near_sigmas.push_back(near_sigma_m(view, initial.radius(), options));
    if (view.near_m > 0.0) near_costs.emplace_back(view, near_sigmas.back());
  }
  Vec3 center = initial.center();
  Quaternion rotation = initial.T_world_quadric.q;
  Vec3 log_axes = initial.semi_axes.array().log();
  // Keeps axes that no view bounds near a sphere.
  const double with_depth = static_cast<double>(near_costs.size());
  const double roundness_weight =
      std::sqrt(options.roundness_weight * (static_cast<double>(views.size()) - with_depth) +
                options.near_roundness_weight * with_depth);
  ceres::NormalPrior roundness(roundness_weight * Mat3::Identity(), Vec3::Constant(log_axes.mean()));
  ceres::SoftLOneLoss loss(1.0);
  ceres::CauchyLoss near_loss(1.0);  // what was taken for the object may be all of it something else

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
  for (NearSideCost& cost : near_costs) problem.AddResidualBlock(&cost, &near_loss, center.data(), log_axes.data());
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
  const Box image = camera.image();
  for (std::size_t i = 0; i < views.size(); ++i) {
    const std::optional<Box> box = project_box(center, shape, projections[i]);
    if (box) fit.mean_iou += iou(clip(*box, image), clip(views[i].box, image));
  }
  fit.mean_iou /= static_cast<double>(views.size());
  fit.center_covariance = center_covariance(projections, views, sigmas, near_sigmas, fit.ellipsoid);
  return fit;
}

std::optional<RayDepths> ray_depths(const Ellipsoid& ellipsoid, const Vec3& origin, const Vec3& direction) {
  // In semi-axes, about the centre: |u + t d|^2 = 1.
  const Quaternion to_axes = ellipsoid.T_world_quadric.q.conjugate();
  const Vec3 u = (to_axes * (origin - ellipsoid.center())).cwiseQuotient(ellipsoid.semi_axes);
  const Vec3 d = (to_axes * direction).cwiseQuotient(ellipsoid.semi_axes);
  const double A = d.squaredNorm(), B = u.dot(d), C = u.squaredNorm() - 1.0;
  if (!(C > 0.0 && B < 0.0)) return std::nullopt;
  const double half = std::sqrt(std::max(0.0, B * B - A * C));
  return RayDepths{(-B - half) / A, (-B + half) / A};
}

}  // namespace semantic_topo_loop::core
