#include "odometry/path_noise.h"

#include <Eigen/Eigenvalues>
#include <cmath>
#include <limits>

#include "geometry/relative_pose.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

std::size_t index(int vertex) { return static_cast<std::size_t>(vertex); }

Mat6 variances(double translation, double rotation) {
  Vec6 diagonal;
  diagonal << Vec3::Constant(translation), Vec3::Constant(rotation);
  return diagonal.asDiagonal();
}

constexpr OdometryNoise kNoNoise{0.0, 0.0, 0.0, 0.0, 0.0, 0.0}, kOnlySuspects{0.0, 0.0, 0.0, 0.0, 0.0, 1.0};

}  // namespace

PathNoise::PathNoise(const std::vector<SE3>& T_world_vertex, const std::vector<OdometryEdge>& edges)
    : vertices_(&T_world_vertex) {
  const std::size_t n = edges.size() + 1;
  for (Sums* sums : {&given_, &translation_, &rotation_, &suspects_}) sums->assign(n, Mat6::Zero());
  residual_.assign(n, Vec6::Zero());
  jump_.assign(n, Vec6::Zero());
  stated_.assign(n, 0);
  for (std::size_t i = 0; i + 1 < n; ++i) {
    const OdometryEdge& edge = edges[i];
    const Mat6 to_origin = transport(T_world_vertex[i + 1].inverse());
    to_origin_.push_back(to_origin);
    const auto carried = [&to_origin](const Mat6& m) { return Mat6(to_origin * m * to_origin.transpose()); };
    const Mat6 given = odometry_covariance(edge, kNoNoise);
    given_[i + 1] = given_[i] + carried(given);
    suspects_[i + 1] = suspects_[i] + carried(odometry_covariance(edge, kOnlySuspects) - given);
    jump_[i + 1] = jump_[i] + to_origin * expected_jump(edge, kOnlySuspects);
    translation_[i + 1] = translation_[i];
    rotation_[i + 1] = rotation_[i];
    residual_[i + 1] = residual_[i];
    stated_[i + 1] = stated_[i] + (edge.covariance ? 1 : 0);
    if (edge.is_break) continue;
    residual_[i + 1] += to_origin * relative_pose_residual(T_world_vertex[i], T_world_vertex[i + 1], edge.T_from_to);
    if (edge.covariance) continue;
    translation_[i + 1] += carried(variances(edge.path_m, 0.0));
    rotation_[i + 1] += carried(variances(0.0, edge.rotation_rad));
  }
}

Innovation PathNoise::innovation(const GraphLoop& loop) const {
  const SE3 &T_world_from = (*vertices_)[index(loop.from)], &T_world_to = (*vertices_)[index(loop.to)];
  const Vec6 e = relative_pose_residual(T_world_from, T_world_to, loop.T_from_to);
  Mat6 by_motion = Mat6::Zero();
  by_motion.topLeftCorner<3, 3>() = so3_exp(e.tail<3>()).toRotationMatrix();
  by_motion.bottomRightCorner<3, 3>() = right_jacobian_inverse(e.tail<3>());
  Innovation innovation;
  innovation.from_origin = by_motion * transport(T_world_to);
  innovation.error = e - innovation.from_origin * (residual_[index(loop.to)] - residual_[index(loop.from)]);
  innovation.jump = innovation.from_origin * (jump_[index(loop.to)] - jump_[index(loop.from)]);
  return innovation;
}

double PathNoise::explaining_factor(const GraphLoop& loop, const OdometryNoise& noise, double max_factor) const {
  const Innovation innovation = this->innovation(loop);
  const auto along = [&](const Sums& sums) {
    const Mat6 difference = sums[index(loop.to)] - sums[index(loop.from)];
    return Mat6(innovation.from_origin * difference * innovation.from_origin.transpose());
  };
  const Mat6 base = loop.covariance + along(given_) + noise.suspicion * noise.suspicion * along(suspects_);
  const Mat6 noise_part = noise.translation_m * noise.translation_m * along(translation_) +
                          noise.rotation_rad * noise.rotation_rad * along(rotation_);
  // In the basis of V, V^T base V = 1 and V^T noise_part V is diagonal.
  const Eigen::GeneralizedSelfAdjointEigenSolver<Mat6> both(noise_part, base);
  if (both.info() != Eigen::Success) return std::numeric_limits<double>::infinity();
  const Vec6 y =
      both.eigenvectors().transpose() * (innovation.error - noise.suspicion * noise.suspicion * innovation.jump);
  const auto chi2 = [&](double factor) {
    return (y.array().square() / (1.0 + factor * factor * both.eigenvalues().array().max(0.0))).sum();
  };
  constexpr double kMedianChi2 = 5.348;  // of six degrees of freedom
  if (chi2(0.0) <= kMedianChi2) return 0.0;
  if (!(chi2(max_factor) <= kMedianChi2)) return std::numeric_limits<double>::infinity();
  double low = 0.0, high = max_factor;
  constexpr int kBisections = 30;
  for (int i = 0; i < kBisections; ++i) {
    const double middle = 0.5 * (low + high);
    (chi2(middle) <= kMedianChi2 ? high : low) = middle;
  }
  return high;
}

bool PathNoise::has_stated(const GraphLoop& loop) const { return stated_[index(loop.to)] != stated_[index(loop.from)]; }

}  // namespace semantic_topo_loop::core
