#include "semantic_topo_loop/geometry/alignment.h"

#include <Eigen/Eigenvalues>
#include <Eigen/SVD>
#include <cmath>

namespace semantic_topo_loop::core {

std::optional<Alignment> align_points(const std::vector<Vec3>& points_a, const std::vector<Vec3>& points_b,
                                      bool with_scale) {
  const std::size_t n = points_a.size();
  if (n < 3 || points_b.size() != n) return std::nullopt;
  const double total = static_cast<double>(n);
  Vec3 mean_a = Vec3::Zero(), mean_b = Vec3::Zero();
  for (std::size_t i = 0; i < n; ++i) {
    mean_a += points_a[i];
    mean_b += points_b[i];
  }
  if (!mean_a.allFinite() || !mean_b.allFinite()) return std::nullopt;
  mean_a /= total;
  mean_b /= total;

  Mat3 cross = Mat3::Zero(), scatter_b = Mat3::Zero();
  for (std::size_t i = 0; i < n; ++i) {
    const Vec3 b = points_b[i] - mean_b;
    cross += 1.0 / total * (points_a[i] - mean_a) * b.transpose();
    scatter_b += 1.0 / total * b * b.transpose();
  }
  const Eigen::JacobiSVD<Mat3> svd(cross, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Vec3& singular = svd.singularValues();
  // A rank-one cross covariance leaves the rotation about the points' line free.
  if (!(singular(1) > 1e-9 * std::max(singular(0), 1e-12)) || !(singular(1) > 1e-15)) return std::nullopt;

  const double sign = (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0.0 ? -1.0 : 1.0;
  const Vec3 d(1.0, 1.0, sign);
  Alignment result;
  const Mat3 R = svd.matrixU() * d.asDiagonal() * svd.matrixV().transpose();
  if (with_scale) result.scale = singular.dot(d) / scatter_b.trace();
  result.T_a_b = SE3(R, mean_a - result.scale * R * mean_b);
  result.covariance_b_m2 = scatter_b;

  double squared = 0.0;
  for (std::size_t i = 0; i < n; ++i) {
    squared +=
        1.0 / total * (points_a[i] - result.scale * (result.T_a_b.q * points_b[i]) - result.T_a_b.t).squaredNorm();
  }
  result.rms_m = std::sqrt(squared);
  return result;
}

Vec3 Alignment::spread_m() const {
  // Of what is symmetric the eigenvalues, which come ascending.
  const Eigen::SelfAdjointEigenSolver<Mat3> solver(covariance_b_m2, Eigen::EigenvaluesOnly);
  return solver.eigenvalues().reverse().cwiseMax(0.0).cwiseSqrt();
}

}  // namespace semantic_topo_loop::core
