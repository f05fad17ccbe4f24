#include "geometry/relative_pose.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <functional>
#include <limits>

#include "semantic_topo_loop/geometry/lie.h"
#include "support/random_motions.h"

namespace semantic_topo_loop::core {
namespace {

SE3 moved(const SE3& T, const Vec6& step) { return {so3_exp(step.tail<3>()) * T.q, T.t + step.head<3>()}; }

Mat6 numeric_jacobian(const std::function<Vec6(const Vec6&)>& function) {
  constexpr double kStep = 1e-6;
  Mat6 jacobian;
  for (int i = 0; i < 6; ++i) {
    const Vec6 step = kStep * Vec6::Unit(i);
    jacobian.col(i) = (function(step) - function(-step)) / (2.0 * kStep);
  }
  return jacobian;
}

TEST(RelativePose, ResidualIsZeroForTheTrueMotion) {
  Random random(1);
  const SE3 T_world_from = random_motion(&random, 2.0, 1.0), T_from_to = random_motion(&random, 1.0, 0.5);
  EXPECT_LT(relative_pose_residual(T_world_from, T_world_from * T_from_to, T_from_to).norm(), 1e-12);
}

TEST(RelativePose, ResidualIsTheMotionAppliedOnTheRight) {
  Random random(2);
  const SE3 T_world_from = random_motion(&random, 2.0, 1.0), T_from_to = random_motion(&random, 1.0, 0.5);
  Vec6 d;
  d << 0.1, -0.2, 0.3, 0.02, 0.03, -0.04;
  const SE3 T_world_to = T_world_from * T_from_to * se3_exp(d);
  EXPECT_LT((relative_pose_residual(T_world_from, T_world_to, T_from_to) - d).norm(), 1e-12);
}

TEST(RelativePose, JacobiansAgreeWithNumericOnes) {
  Random random(3);
  for (int trial = 0; trial < 100; ++trial) {
    const SE3 T_world_from = random_motion(&random, 3.0, 2.0);
    const SE3 T_from_to = random_motion(&random, 1.0, 0.6);
    const SE3 T_world_to = T_world_from * T_from_to * random_motion(&random, 0.5, trial < 50 ? 0.7 : 1e-5);
    const RelativePoseTerms terms = relative_pose_terms(T_world_from, T_world_to, T_from_to);
    const Mat6 by_from = numeric_jacobian(
        [&](const Vec6& d) { return relative_pose_residual(moved(T_world_from, d), T_world_to, T_from_to); });
    const Mat6 by_to = numeric_jacobian(
        [&](const Vec6& d) { return relative_pose_residual(T_world_from, moved(T_world_to, d), T_from_to); });
    EXPECT_LT((terms.J_from - by_from).cwiseAbs().maxCoeff(), 1e-6) << trial;
    EXPECT_LT((terms.J_to - by_to).cwiseAbs().maxCoeff(), 1e-6) << trial;
  }
}

TEST(RelativePose, TransportCarriesAMotionToTheOtherEnd) {
  Random random(4);
  const SE3 T = random_motion(&random, 2.0, 1.0);
  const Mat6 numeric = numeric_jacobian([&](const Vec6& d) { return se3_log(T.inverse() * se3_exp(d) * T); });
  EXPECT_LT((transport(T) - numeric).cwiseAbs().maxCoeff(), 1e-8);
}

TEST(RelativePose, TransportOfAProductIsTheProductInReverse) {
  Random random(5);
  const SE3 A = random_motion(&random, 2.0, 1.0), B = random_motion(&random, 2.0, 1.0);
  EXPECT_LT((transport(A * B) - transport(B) * transport(A)).cwiseAbs().maxCoeff(), 1e-12);
}

TEST(RelativePose, InverseCovarianceAgreesWithSampling) {
  Random random(6);
  const SE3 T = random_motion(&random, 1.0, 1.0);
  Mat6 root = Mat6::Identity();
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < i; ++j) root(i, j) = 0.3 * random.normal();
  }
  root *= 0.01;
  Mat6 sampled = Mat6::Zero();
  constexpr int kSamples = 40000;
  for (int k = 0; k < kSamples; ++k) {
    const Vec6 d = random_tangent(&random, 1.0, 1.0);
    const Vec6 e = se3_log(T * (T * se3_exp(root * d)).inverse());
    sampled += e * e.transpose() / kSamples;
  }
  const Mat6 expected = inverse_covariance(T, root * root.transpose());
  EXPECT_LT((sampled - expected).cwiseAbs().maxCoeff(), 0.03 * expected.cwiseAbs().maxCoeff());
}

TEST(RelativePose, SquareRootInformationGivesTheMahalanobisDistance) {
  Random random(7);
  Mat6 root = Mat6::Identity();
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < i; ++j) root(i, j) = random.normal();
  }
  const Mat6 covariance = root * root.transpose();
  const Vec6 e = random_tangent(&random, 1.0, 1.0);
  EXPECT_NEAR((square_root_information(covariance) * e).squaredNorm(), e.dot(covariance.inverse() * e), 1e-8);
}

TEST(RelativePose, CovariancesAreChecked) {
  EXPECT_TRUE(is_covariance(1e-4 * Mat6::Identity()));
  EXPECT_FALSE(is_covariance(Mat6::Zero()));
  EXPECT_FALSE(is_covariance(-Mat6::Identity()));
  Mat6 m = Mat6::Identity();
  m(2, 3) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(is_covariance(m));
  m(2, 3) = std::numeric_limits<double>::infinity();
  EXPECT_FALSE(is_covariance(m));
  m(2, 3) = 0.5;
  EXPECT_FALSE(is_covariance(m)) << "not symmetric";
  m(3, 2) = 0.5;
  EXPECT_TRUE(is_covariance(m));
  m(2, 3) = m(3, 2) = 1.5;
  EXPECT_FALSE(is_covariance(m)) << "not positive definite";
}

}  // namespace
}  // namespace semantic_topo_loop::core
