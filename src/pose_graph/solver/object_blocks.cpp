#include "pose_graph/solver/object_blocks.h"

#include <cmath>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kUnseenResidual = 20.0;  // far outside the noise: no view may vanish to lower the cost
constexpr double kLossScale = 3.08;       // root of the 95 % quantile of chi^2 with four degrees of freedom
constexpr double kAxesSigma = 0.5;        // of the logarithms of the semi-axes, about those that the map has

template <int n>
void write(const Eigen::Matrix<double, n, 3>& J, double* target) {
  for (int row = 0; row < n; ++row) {
    for (int column = 0; column < 3; ++column) target[3 * row + column] = J(row, column);
  }
}

/// Derivative by the quaternion (x, y, z, w) from that by a small rotation of the outer frame.
template <int n>
void write(const Eigen::Matrix<double, n, 3>& J, const Quaternion& q, double* target) {
  const Eigen::Matrix<double, n, 4> by_quaternion = 2.0 * J * quaternion_by_rotation(q).transpose();
  for (int row = 0; row < n; ++row) {
    for (int column = 0; column < 4; ++column) target[4 * row + column] = by_quaternion(row, column);
  }
}

/// Errors / sigma of one view over (t, q, centre, log axes).
template <int n>
class ViewCost : public ceres::SizedCostFunction<n, 3, 4, 3, 3> {
 public:
  ViewCost(const GraphObjectView& view, const Quaternion& axes, double sigma)
      : view_(view), axes_(axes), sigma_(sigma) {}

  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const SE3 T_world_camera{Quaternion(blocks[1]), Vec3(blocks[0])};
    const Ellipsoid ellipsoid{SE3(axes_, Vec3(blocks[2])), Vec3(blocks[3]).array().exp()};
    const ObjectTerms<n> terms = this->terms(T_world_camera, ellipsoid);
    for (int i = 0; i < n; ++i) residuals[i] = terms.error(i) / sigma_;
    if (jacobians == nullptr) return true;
    if (jacobians[0] != nullptr) write<n>(terms.camera_t / sigma_, jacobians[0]);
    if (jacobians[1] != nullptr) write<n>(terms.camera_rotation / sigma_, T_world_camera.q, jacobians[1]);
    if (jacobians[2] != nullptr) write<n>(terms.center / sigma_, jacobians[2]);
    if (jacobians[3] != nullptr) write<n>(terms.log_axes / sigma_, jacobians[3]);
    return true;
  }

 private:
  ObjectTerms<n> terms(const SE3& T_world_camera, const Ellipsoid& ellipsoid) const {
    if constexpr (n == 1) {
      return depth_terms(*view_.depth, T_world_camera, ellipsoid);
    } else {
      if (const auto terms = box_terms(view_, T_world_camera, ellipsoid)) return *terms;
      ObjectTerms<n> unseen;
      unseen.error.setConstant(kUnseenResidual * sigma_);
      return unseen;
    }
  }

  GraphObjectView view_;
  Quaternion axes_;
  double sigma_;
};

/// Keeps the logarithms of the semi-axes near their start.
class AxesCost final : public ceres::SizedCostFunction<3, 3> {
 public:
  explicit AxesCost(const Vec3& log_axes) : log_axes_(log_axes) {}
  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    for (int i = 0; i < 3; ++i) residuals[i] = (blocks[0][i] - log_axes_(i)) / kAxesSigma;
    if (jacobians != nullptr && jacobians[0] != nullptr) write<3>(Mat3::Identity() / kAxesSigma, jacobians[0]);
    return true;
  }

 private:
  Vec3 log_axes_;
};

/// A quarter of the object's radius may be in doubt, and what a Kinect adds.
double depth_sigma_m(const GraphObject& object, double distance_m) {
  const double radius = std::cbrt(object.semi_axes.prod());
  return 0.25 * radius + 0.01 + 0.003 * distance_m * distance_m;
}

ceres::LossFunction* make_loss(double weight) {
  return new ceres::ScaledLoss(new ceres::CauchyLoss(kLossScale), weight, ceres::TAKE_OWNERSHIP);
}

}  // namespace

ObjectBlocks::ObjectBlocks(const GraphObjects& objects, std::vector<SE3>* T_world_vertex, ceres::Problem* problem) {
  const ObjectNoise& noise = objects.noise;
  for (const GraphObject& object : objects.objects) {
    const SE3 T_world_quadric = (*T_world_vertex)[static_cast<std::size_t>(object.anchor)] * object.T_anchor_quadric;
    unknowns_.push_back({T_world_quadric.t, object.semi_axes.array().log()});
    Unknowns& unknowns = unknowns_.back();
    problem->AddResidualBlock(new AxesCost(unknowns.log_axes), nullptr, unknowns.log_axes.data());
    for (const GraphObjectView& view : object.views) {
      SE3& T_world_camera = (*T_world_vertex)[static_cast<std::size_t>(view.vertex)];
      const auto add = [&](ceres::CostFunction* cost) {
        problem->AddResidualBlock(cost, make_loss(noise.weight), T_world_camera.t.data(),
                                  T_world_camera.q.coeffs().data(), unknowns.center.data(), unknowns.log_axes.data());
      };
      const double sigma_px = noise.sigma_px + noise.sigma_share * view.box.size();
      add(new ViewCost<4>(view, T_world_quadric.q, sigma_px));
      if (view.depth) add(new ViewCost<1>(view, T_world_quadric.q, depth_sigma_m(object, view.depth->distance_m)));
    }
  }
}

}  // namespace semantic_topo_loop::core
