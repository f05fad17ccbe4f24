#include "semantic_topo_loop/loop/submap_refiner.h"

#include <ceres/ceres.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>

namespace semantic_topo_loop::core {
namespace {

using Vec5 = Eigen::Matrix<double, 5, 1>;
using Mat5 = Eigen::Matrix<double, 5, 5>;
using Mat65 = Eigen::Matrix<double, 6, 5>;
using Mat46 = Eigen::Matrix<double, 4, 6, Eigen::RowMajor>;
using Mat45 = Eigen::Matrix<double, 4, 5, Eigen::RowMajor>;

constexpr int kMaxIterations = 15;
constexpr double kMinInformation = 1e-6;

/// Derivative of exp: exp(w + dw) = exp(w) exp(J dw) to first order.
Mat3 right_jacobian(const Vec3& w) {
  const double angle = w.norm();
  const Mat3 W = hat(w);
  if (angle < 1e-5) return Mat3::Identity() - 0.5 * W + W * W / 6.0;
  const double angle2 = angle * angle;
  return Mat3::Identity() - (1.0 - std::cos(angle)) / angle2 * W + (angle - std::sin(angle)) / (angle2 * angle) * W * W;
}

/// One box of a matched object, on either side.
struct BoxMeasurement {
  Mat3 R_camera_local;
  Vec3 t_camera_local;
  Vec4 edges;
  Vec4 sqrt_information;
};

/// Residual: (box edges of the projected spheroid - measured edges) / sigma. The spheroid lives in a's frame; for a
/// box of b it is taken over by the inverse of T_a_b = T_0 * exp(delta).
class BoxCost : public ceres::SizedCostFunction<4, 6, 5> {
 public:
  BoxCost(const BoxMeasurement& measurement, bool in_b, const SE3& T_0, const Vec3& axis_a)
      : m_(measurement), in_b_(in_b), R_0_b_(T_0.rotation().transpose()), t_0_(T_0.t), axis_a_(axis_a) {}

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const Eigen::Map<const Vec6> delta(parameters[0]);
    const Eigen::Map<const Vec5> object(parameters[1]);
    const Mat3 R_delta = in_b_ ? so3_exp(delta.tail<3>()).toRotationMatrix() : Mat3::Identity();
    const Mat3 R_local_a = in_b_ ? Mat3(R_delta.transpose() * R_0_b_) : Mat3(Mat3::Identity());
    const Vec3 center_local = in_b_ ? Vec3(R_delta.transpose() * (R_0_b_ * (object.head<3>() - t_0_) - delta.head<3>()))
                                    : Vec3(object.head<3>());
    const Vec3 axis_local = R_local_a * axis_a_;
    const auto projection = project_spheroid(m_.R_camera_local * center_local + m_.t_camera_local,
                                             m_.R_camera_local * axis_local, object.tail<2>());
    if (!projection) return false;
    Eigen::Map<Vec4>(residuals, 4) = m_.sqrt_information.cwiseProduct(projection->edges - m_.edges);
    if (jacobians == nullptr) return true;
    const Eigen::Matrix<double, 4, 3> d_center =
        m_.sqrt_information.asDiagonal() * projection->d_center * m_.R_camera_local;
    if (jacobians[0] != nullptr) {
      Eigen::Map<Mat46> J(jacobians[0]);
      J.setZero();
      if (in_b_) {
        const Eigen::Matrix<double, 4, 3> d_axis =
            m_.sqrt_information.asDiagonal() * projection->d_axis * m_.R_camera_local;
        J.leftCols<3>() = -d_center * R_delta.transpose();
        J.rightCols<3>() = (d_center * hat(center_local) + d_axis * hat(axis_local)) * right_jacobian(delta.tail<3>());
      }
    }
    if (jacobians[1] != nullptr) {
      Eigen::Map<Mat45> J(jacobians[1]);
      J.leftCols<3>() = d_center * R_local_a;
      J.rightCols<2>() = m_.sqrt_information.asDiagonal() * projection->d_log_axes;
    }
    return true;
  }

 private:
  BoxMeasurement m_;
  bool in_b_;
  Mat3 R_0_b_;
  Vec3 t_0_;
  Vec3 axis_a_;
};

/// The up direction of both submaps in a's frame.
Vec3 common_axis(const LocalMap& a, const LocalMap& b, const SE3& T_a_b) {
  const Vec3 up_b = T_a_b.q * b.up.direction;
  if (a.up.certain != b.up.certain) return a.up.certain ? a.up.direction : up_b;
  const Vec3 sum = a.up.direction + up_b;
  return sum.norm() > 0.5 ? Vec3(sum.normalized()) : a.up.direction;
}

/// The whole problem: measurements with the index of their object, and the unknowns.
class RefinementProblem {
 public:
  RefinementProblem(const LocalMap& a, const LocalMap& b, const SE3& T_0, const std::vector<NodePair>& pairs)
      : a_(a), b_(b), T_0_(T_0), axis_(common_axis(a, b, T_0)), objects_(pairs.size()) {
    for (std::size_t k = 0; k < pairs.size(); ++k) {
      const Spheroid& s_a = a.objects[static_cast<std::size_t>(pairs[k].a)].spheroid;
      const Spheroid& s_b = b.objects[static_cast<std::size_t>(pairs[k].b)].spheroid;
      objects_[k] << 0.5 * (s_a.center + T_0 * s_b.center), 0.5 * (s_a.log_axes + s_b.log_axes);
    }
  }

  void add_views(int views, double sigma_px, double sigma_share, const std::vector<NodePair>& pairs) {
    for (std::size_t k = 0; k < pairs.size(); ++k) {
      add_object(a_, a_.objects[static_cast<std::size_t>(pairs[k].a)], false, k, views, sigma_px, sigma_share);
      add_object(b_, b_.objects[static_cast<std::size_t>(pairs[k].b)], true, k, views, sigma_px, sigma_share);
    }
  }

  bool solve() {
    ceres::Problem::Options problem_options;
    problem_options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    problem_options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    ceres::Problem problem(problem_options);
    ceres::SoftLOneLoss loss(1.0);
    ceres::Solver::Options options;
    auto* ordering = new ceres::ParameterBlockOrdering;  // owned by the options
    for (const Term& term : terms_) {
      problem.AddResidualBlock(term.cost.get(), &loss, delta_.data(), objects_[term.object].data());
    }
    for (Vec5& object : objects_) ordering->AddElementToGroup(object.data(), 0);
    ordering->AddElementToGroup(delta_.data(), 1);
    options.linear_solver_type = ceres::DENSE_SCHUR;
    options.linear_solver_ordering.reset(ordering);
    options.max_num_iterations = kMaxIterations;
    options.num_threads = 1;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    return summary.IsSolutionUsable() && delta_.allFinite();
  }

  SE3 T_a_b() const { return T_0_ * se3_exp(delta_); }

  /// Marginal covariance of the pose by the Schur complement, and the median residual.
  /// @return false if the pose is not determined
  bool assess(double inflation, Refinement* refinement) const {
    Mat6 H = Mat6::Zero();
    std::vector<Mat65> H_pose_object(objects_.size(), Mat65::Zero());
    std::vector<Mat5> H_object(objects_.size(), Mat5::Zero());
    std::vector<double> residuals;
    for (const Term& term : terms_) {
      Vec4 r;
      Mat46 J_pose;
      Mat45 J_object;
      const std::array<const double*, 2> parameters{delta_.data(), objects_[term.object].data()};
      std::array<double*, 2> jacobians{J_pose.data(), J_object.data()};
      if (!term.cost->Evaluate(parameters.data(), r.data(), jacobians.data())) return false;
      const double weight = 1.0 / std::sqrt(1.0 + r.squaredNorm());
      H += weight * J_pose.transpose() * J_pose;
      H_pose_object[term.object] += weight * J_pose.transpose() * J_object;
      H_object[term.object] += weight * J_object.transpose() * J_object;
      for (int i = 0; i < 4; ++i) residuals.push_back(std::abs(r(i)));
    }
    for (std::size_t k = 0; k < objects_.size(); ++k) {
      H_object[k].diagonal().array() += kMinInformation;
      H -= H_pose_object[k] * H_object[k].ldlt().solve(H_pose_object[k].transpose());
    }
    const Eigen::LDLT<Mat6> ldlt(H);
    if (!H.allFinite() || !(ldlt.vectorD().minCoeff() > kMinInformation)) return false;
    // From a change of delta to a right perturbation of the result.
    Mat6 J = Mat6::Identity();
    J.topLeftCorner<3, 3>() = so3_exp(delta_.tail<3>()).conjugate().toRotationMatrix();
    J.bottomRightCorner<3, 3>() = right_jacobian(delta_.tail<3>());
    const Mat6 covariance = J * ldlt.solve(Mat6::Identity()) * J.transpose();
    refinement->covariance = 0.5 * inflation * inflation * (covariance + covariance.transpose());
    const auto middle = residuals.begin() + static_cast<std::ptrdiff_t>(residuals.size() / 2);
    std::nth_element(residuals.begin(), middle, residuals.end());
    refinement->median_residual = *middle;
    return refinement->covariance.allFinite();
  }

 private:
  struct Term {
    std::unique_ptr<BoxCost> cost;
    std::size_t object;
  };

  void add_object(const LocalMap& map, const LocalObject& object, bool in_b, std::size_t index, int views,
                  double sigma_px, double sigma_share) {
    const int n = static_cast<int>(object.views.size());
    const int count = std::min(n, views);
    for (int k = 0; k < count; ++k) {
      const ObjectView& view = object.views[static_cast<std::size_t>(k * n / count)];
      const LocalFrame& frame = map.frames[static_cast<std::size_t>(view.frame)];
      const Vec2 size_px = frame.focal_px.cwiseProduct(Vec2(view.box.width(), view.box.height()));
      const double sigma = sigma_px + sigma_share * std::sqrt(size_px.prod());
      const Vec4 sqrt_information =
          Vec4(frame.focal_px.x(), frame.focal_px.y(), frame.focal_px.x(), frame.focal_px.y()) / sigma;
      const BoxMeasurement measurement{frame.R_camera_local, frame.t_camera_local, view.box.edges(), sqrt_information};
      terms_.push_back({std::make_unique<BoxCost>(measurement, in_b, T_0_, axis_), index});
    }
  }

  const LocalMap& a_;
  const LocalMap& b_;
  SE3 T_0_;
  Vec3 axis_;
  Vec6 delta_ = Vec6::Zero();
  std::vector<Vec5> objects_;
  std::vector<Term> terms_;
};

}  // namespace

SubmapRefiner::SubmapRefiner(const LoopOptions& options)
    : views_(options.refine_views),
      sigma_px_(options.refine_sigma_px),
      sigma_share_(options.refine_sigma_share),
      inflation_(options.covariance_inflation) {}

std::optional<Refinement> SubmapRefiner::refine(const LocalMap& a, const LocalMap& b, const SE3& T_a_b,
                                                const std::vector<NodePair>& pairs) const {
  if (pairs.size() < 3 || !T_a_b.is_finite()) return std::nullopt;
  RefinementProblem problem(a, b, T_a_b, pairs);
  problem.add_views(views_, sigma_px_, sigma_share_, pairs);
  if (!problem.solve()) return std::nullopt;
  Refinement refinement;
  refinement.T_a_b = problem.T_a_b();
  if (!problem.assess(inflation_, &refinement)) return std::nullopt;
  return refinement;
}

}  // namespace semantic_topo_loop::core
