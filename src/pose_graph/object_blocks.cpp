#include "object_blocks.h"

#include <cmath>

#include "semantic_topo_loop/map/quadric_fit.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kUnseenResidual = 20.0;     // far outside the noise: no view may vanish to lower the cost
constexpr double kLossScale = 3.08;          // root of the 95 % quantile of chi^2 with four degrees of freedom
constexpr double kAxesSigma = 0.5;           // of the logarithms of the semi-axes, about those that the map has
constexpr double kVisibleShare = 2.0 / 3.0;  // of the extent: mean height of a hemisphere over its outline

template <int kRows>
using ByRotation = Eigen::Matrix<double, kRows, 3>;

/// Derivative by the quaternion (x, y, z, w) from that by a small rotation of the outer frame; see graph_solver.cpp.
template <int kRows>
void write_quaternion(const ByRotation<kRows>& J, const Quaternion& q, double* target) {
  Eigen::Matrix<double, 4, 3> plus;
  plus.topRows<3>() = q.w() * Mat3::Identity() - hat(q.vec());
  plus.bottomRows<1>() = -q.vec().transpose();
  const Eigen::Matrix<double, kRows, 4> by_quaternion = 2.0 * J * plus.transpose();
  for (int r = 0; r < kRows; ++r) {
    for (int c = 0; c < 4; ++c) target[4 * r + c] = by_quaternion(r, c);
  }
}

template <int kRows>
void write(const ByRotation<kRows>& J, double* target) {
  for (int r = 0; r < kRows; ++r) {
    for (int c = 0; c < 3; ++c) target[3 * r + c] = J(r, c);
  }
}

/// The parameters of a view, as Ceres gives them.
struct Parameters {
  explicit Parameters(double const* const* blocks)
      : t(blocks[0]), q(blocks[1]), center(blocks[2]), log_axes(blocks[3]) {}
  Vec3 t;
  Quaternion q;
  Vec3 center, log_axes;
};

template <int kRows>
struct Jacobians {
  ByRotation<kRows> t = ByRotation<kRows>::Zero(), rotation = t, center = t, log_axes = t;

  void write_to(const Quaternion& q, double** blocks) const {
    if (blocks[0] != nullptr) write<kRows>(t, blocks[0]);
    if (blocks[1] != nullptr) write_quaternion<kRows>(rotation, q, blocks[1]);
    if (blocks[2] != nullptr) write<kRows>(center, blocks[2]);
    if (blocks[3] != nullptr) write<kRows>(log_axes, blocks[3]);
  }
};

class BoxCost final : public ceres::SizedCostFunction<4, 3, 4, 3, 3> {
 public:
  BoxCost(const ObjectView& view, const Quaternion& axes, double sigma_px) : view_(view), axes_(axes) {
    for (int i = 0; i < 4; ++i) weights_(i) = (view.truncated & (1 << i)) != 0 ? 0.0 : 1.0 / sigma_px;
  }

  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const Parameters p(blocks);
    const Mat34 P = projection_matrix(view_, SE3(p.q, p.t));
    const Ellipsoid ellipsoid{SE3(axes_, p.center), p.log_axes.array().exp()};
    BoxJacobian J;
    const std::optional<Box> box = project_box(ellipsoid, P, jacobians != nullptr ? &J : nullptr);
    Eigen::Map<Vec4> r(residuals);
    r = box ? Vec4(weights_.cwiseProduct(box->edges() - view_.box.edges()))
            : Vec4((weights_.array() > 0.0).select(kUnseenResidual, Vec4::Zero()));
    if (jacobians == nullptr) return true;
    Jacobians<4> all;
    if (box) {
      // What the camera does, the ellipsoid does the other way round.
      all.t = -(weights_.asDiagonal() * J.center);
      all.rotation = weights_.asDiagonal() * (J.center * hat(p.center - p.t) - J.rotation);
      all.center = weights_.asDiagonal() * J.center;
      all.log_axes = weights_.asDiagonal() * J.log_axes;
    }
    all.write_to(p.q, jacobians);
    return true;
  }

 private:
  ObjectView view_;
  Vec4 weights_;
  Quaternion axes_;
};

class DepthCost final : public ceres::SizedCostFunction<1, 3, 4, 3, 3> {
 public:
  DepthCost(const ObjectView& view, const Quaternion& axes, double sigma_m)
      : depth_(*view.depth), axes_(axes.toRotationMatrix()), sigma_m_(sigma_m) {}

  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const Parameters p(blocks);
    const Vec3 ray = p.q.normalized() * depth_.ray_camera;
    const Vec3 squared_axes = (2.0 * p.log_axes).array().exp();
    const Vec3 along = axes_.transpose() * ray;
    const double extent = std::sqrt(squared_axes.dot(along.cwiseAbs2()));
    const Vec3 to_center = p.center - p.t;
    residuals[0] = (ray.dot(to_center) - kVisibleShare * extent - depth_.distance_m) / sigma_m_;
    if (jacobians == nullptr) return true;
    const Vec3 shape_ray = axes_ * squared_axes.cwiseProduct(along);
    Jacobians<1> all;
    all.t = -ray.transpose() / sigma_m_;
    all.center = ray.transpose() / sigma_m_;
    all.rotation = (ray.cross(to_center) - kVisibleShare / extent * ray.cross(shape_ray)).transpose() / sigma_m_;
    all.log_axes = -kVisibleShare / (extent * sigma_m_) * squared_axes.cwiseProduct(along.cwiseAbs2()).transpose();
    all.write_to(p.q, jacobians);
    return true;
  }

 private:
  SurfaceDepth depth_;
  Mat3 axes_;
  double sigma_m_;
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

/// Half of the object's depth may be in doubt, and what the sensor adds, as a Kinect does.
double depth_sigma_m(const GraphObject& object, double distance_m) {
  const double radius = std::cbrt(object.semi_axes.prod());
  return 0.25 * radius + 0.01 + 0.003 * distance_m * distance_m;
}

ceres::LossFunction* make_loss(double weight) {
  return new ceres::ScaledLoss(new ceres::CauchyLoss(kLossScale), weight, ceres::TAKE_OWNERSHIP);
}

}  // namespace

ceres::CostFunction* make_box_cost(const ObjectView& view, const Quaternion& axes, double sigma_px) {
  return new BoxCost(view, axes, sigma_px);
}

ceres::CostFunction* make_depth_cost(const ObjectView& view, const Quaternion& axes, double sigma_m) {
  return new DepthCost(view, axes, sigma_m);
}

ObjectBlocks::ObjectBlocks(const GraphObjects& objects, std::vector<SE3>* T_world_vertex, ceres::Problem* problem) {
  const ObjectNoise& noise = objects.noise;
  for (const GraphObject& object : objects.objects) {
    const SE3 T_world_quadric = (*T_world_vertex)[static_cast<std::size_t>(object.anchor)] * object.T_anchor_quadric;
    unknowns_.push_back({T_world_quadric.t, object.semi_axes.array().log()});
    Unknowns& unknowns = unknowns_.back();
    problem->AddResidualBlock(new AxesCost(unknowns.log_axes), nullptr, unknowns.log_axes.data());
    for (const ObjectView& view : object.views) {
      SE3& T_world_camera = (*T_world_vertex)[static_cast<std::size_t>(view.vertex)];
      const auto add = [&](ceres::CostFunction* cost) {
        problem->AddResidualBlock(cost, make_loss(noise.weight), T_world_camera.t.data(),
                                  T_world_camera.q.coeffs().data(), unknowns.center.data(), unknowns.log_axes.data());
      };
      add(make_box_cost(view, T_world_quadric.q, noise.sigma_px + noise.sigma_share * view.box.size()));
      if (view.depth) {
        add(make_depth_cost(view, T_world_quadric.q, depth_sigma_m(object, view.depth->distance_m)));
      }
    }
  }
}

}  // namespace semantic_topo_loop::core
