#include "semantic_topo_loop/pose_graph/innovation_model.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>

#include "semantic_topo_loop/pose_graph/relative_pose.h"

namespace semantic_topo_loop::core {
namespace {

/// Two loops from the same windows still differ a little: their keyframes do.
constexpr double kMaxCorrelation = 0.95;

Eigen::Index row(std::size_t loop) { return 6 * static_cast<Eigen::Index>(loop); }

Mat6 variances(double translation, double rotation) {
  Vec6 diagonal;
  diagonal << Vec3::Constant(translation), Vec3::Constant(rotation);
  return diagonal.asDiagonal();
}

}  // namespace

void InnovationModel::accumulate_edges(const std::vector<SE3>& T_world_vertex, const std::vector<OdometryEdge>& edges) {
  const std::size_t n = edges.size() + 1;
  sum_given_.assign(n, Mat6::Zero());
  sum_translation_.assign(n, Mat6::Zero());
  sum_rotation_.assign(n, Mat6::Zero());
  sum_residual_.assign(n, Vec6::Zero());
  for (std::size_t i = 0; i + 1 < n; ++i) {
    const OdometryEdge& edge = edges[i];
    const Mat6 to_origin = transport(T_world_vertex[i + 1].inverse());
    const bool is_given = edge.is_break || edge.covariance;
    const auto carried = [&to_origin](const Mat6& m) { return Mat6(to_origin * m * to_origin.transpose()); };
    sum_given_[i + 1] = sum_given_[i] + carried(odometry_covariance(edge, {0.0, 0.0}));
    sum_translation_[i + 1] = sum_translation_[i];
    sum_rotation_[i + 1] = sum_rotation_[i];
    sum_residual_[i + 1] = sum_residual_[i];
    if (!edge.is_break) {
      sum_residual_[i + 1] +=
          to_origin * relative_pose_residual(T_world_vertex[i], T_world_vertex[i + 1], edge.T_from_to);
    }
    if (is_given) continue;
    sum_translation_[i + 1] += carried(variances(edge.path_m, 0.0));
    sum_rotation_[i + 1] += carried(variances(0.0, edge.rotation_rad));
  }
}

InnovationModel::InnovationModel(const std::vector<SE3>& T_world_vertex, const std::vector<OdometryEdge>& edges,
                                 const std::vector<GraphLoop>& loops) {
  accumulate_edges(T_world_vertex, edges);
  const auto n = row(loops.size());
  innovation_.resize(n);
  for (Eigen::MatrixXd* m : {&given_, &translation_, &rotation_, &loops_}) m->setZero(n, n);
  std::vector<Mat6> from_origin(loops.size()), roots(loops.size());
  for (std::size_t k = 0; k < loops.size(); ++k) {
    const GraphLoop& loop = loops[k];
    const auto from = static_cast<std::size_t>(loop.from), to = static_cast<std::size_t>(loop.to);
    const Vec6 e = relative_pose_residual(T_world_vertex[from], T_world_vertex[to], loop.T_from_to);
    Mat6 by_motion = Mat6::Zero();
    by_motion.topLeftCorner<3, 3>() = so3_exp(e.tail<3>()).toRotationMatrix();
    by_motion.bottomRightCorner<3, 3>() = right_jacobian_inverse(e.tail<3>());
    from_origin[k] = by_motion * transport(T_world_vertex[to]);
    innovation_.segment<6>(row(k)) = e - from_origin[k] * (sum_residual_[to] - sum_residual_[from]);
    loop_covariances_.push_back(loop.covariance);
    roots[k] = loop.covariance.llt().matrixL();
  }
  for (std::size_t k = 0; k < loops.size(); ++k) {
    for (std::size_t l = 0; l <= k; ++l) {
      const auto begin = static_cast<std::size_t>(std::max(loops[k].from, loops[l].from));
      const auto end = static_cast<std::size_t>(std::min(loops[k].to, loops[l].to));
      const double shared = k == l ? 1.0 : std::min(kMaxCorrelation, shared_evidence(loops[k], loops[l]));
      loops_.block<6, 6>(row(k), row(l)) = shared * roots[k] * roots[l].transpose();
      if (begin >= end) continue;
      const auto between = [&](const std::vector<Mat6>& sums) {
        return Mat6(from_origin[k] * (sums[end] - sums[begin]) * from_origin[l].transpose());
      };
      given_.block<6, 6>(row(k), row(l)) = between(sum_given_);
      translation_.block<6, 6>(row(k), row(l)) = between(sum_translation_);
      rotation_.block<6, 6>(row(k), row(l)) = between(sum_rotation_);
    }
  }
}

double InnovationModel::cost(const OdometryNoise& noise, double loop_factor) const {
  Eigen::MatrixXd covariance = loop_factor * loop_factor * loops_ + given_;
  covariance += noise.translation_m * noise.translation_m * translation_;
  covariance += noise.rotation_rad * noise.rotation_rad * rotation_;
  const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>, Eigen::Lower> factor(covariance);
  if (factor.info() != Eigen::Success) return std::numeric_limits<double>::infinity();
  const Eigen::VectorXd whitened = factor.matrixL().solve(innovation_);
  return 0.5 * whitened.squaredNorm() + covariance.diagonal().array().log().sum();
}

double InnovationModel::explaining_factor(std::size_t k, const OdometryNoise& noise, double max_factor) const {
  constexpr double kMedianChi2 = 5.348;  // of six degrees of freedom
  const Vec6 y = innovation_.segment<6>(row(k));
  const auto block = [k](const Eigen::MatrixXd& m) { return Mat6(m.block<6, 6>(row(k), row(k))); };
  const Mat6 base = loop_covariances_[k] + block(given_);
  const Mat6 noise_part = noise.translation_m * noise.translation_m * block(translation_) +
                          noise.rotation_rad * noise.rotation_rad * block(rotation_);
  const auto is_explained = [&](double factor) {
    const Mat6 covariance = base + factor * factor * noise_part;
    return y.dot(covariance.llt().solve(y)) <= kMedianChi2;
  };
  if (is_explained(0.0)) return 0.0;
  if (!is_explained(max_factor)) return std::numeric_limits<double>::infinity();
  double low = 0.0, high = max_factor;
  constexpr int kBisections = 30;
  for (int i = 0; i < kBisections; ++i) {
    const double middle = 0.5 * (low + high);
    (is_explained(middle) ? high : low) = middle;
  }
  return high;
}

}  // namespace semantic_topo_loop::core
