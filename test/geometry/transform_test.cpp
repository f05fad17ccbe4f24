#include <gtest/gtest.h>

#include <Eigen/LU>
#include <functional>
#include <limits>

#include "geometry/relative_pose.h"
#include "semantic_topo_loop/geometry/alignment.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "support/random_motions.h"
#include "support/random_poses.h"

namespace semantic_topo_loop::core {
namespace {

struct Cloud {
  std::vector<Vec3> a, b;
};

/// Points b and their images a under scale and T_a_b.
Cloud make_cloud(RandomPoses* random, const SE3& T_a_b, double scale, int n, double noise_m) {
  Cloud cloud;
  for (int i = 0; i < n; ++i) {
    cloud.b.push_back(random->vector(2.0));
    cloud.a.push_back(scale * (T_a_b.q * cloud.b.back()) + T_a_b.t + random->vector(1.0) * noise_m);
  }
  return cloud;
}

TEST(Alignment, RecoversRandomTransforms) {
  RandomPoses random(21);
  for (int i = 0; i < 100; ++i) {
    const SE3 T = random.pose(5.0);
    const Cloud cloud = make_cloud(&random, T, 1.0, 3 + i % 8, 0.0);
    const std::optional<Alignment> found = align_points(cloud.a, cloud.b);
    ASSERT_TRUE(found);
    EXPECT_NEAR((found->T_a_b.matrix() - T.matrix()).norm(), 0.0, 1e-9);
    EXPECT_EQ(found->scale, 1.0);
    EXPECT_NEAR(found->rms_m, 0.0, 1e-9);
  }
}

TEST(Alignment, RecoversTheScaleOnRequest) {
  RandomPoses random(22);
  for (const double scale : {0.2, 1.0, 7.5}) {
    const SE3 T = random.pose(5.0);
    const Cloud cloud = make_cloud(&random, T, scale, 12, 0.0);
    const std::optional<Alignment> found = align_points(cloud.a, cloud.b, true);
    ASSERT_TRUE(found);
    EXPECT_NEAR(found->scale, scale, 1e-9);
    EXPECT_NEAR((found->T_a_b.matrix() - T.matrix()).norm(), 0.0, 1e-9);
    EXPECT_GT(align_points(cloud.a, cloud.b)->rms_m, scale == 1.0 ? -1.0 : 0.1);
  }
}

TEST(Alignment, IsTheLeastSquaresOptimum) {
  RandomPoses random(23);
  const Cloud cloud = make_cloud(&random, random.pose(1.0), 1.0, 30, 0.05);
  const std::optional<Alignment> found = align_points(cloud.a, cloud.b);
  ASSERT_TRUE(found);
  const auto rms = [&cloud](const SE3& T) {
    double sum = 0.0;
    for (std::size_t i = 0; i < cloud.a.size(); ++i) sum += (cloud.a[i] - T * cloud.b[i]).squaredNorm();
    return std::sqrt(sum / static_cast<double>(cloud.a.size()));
  };
  EXPECT_NEAR(found->rms_m, rms(found->T_a_b), 1e-12);
  for (int i = 0; i < 200; ++i) {
    const SE3 nearby = found->T_a_b * SE3(so3_exp(random.vector(0.01)), random.vector(0.01));
    EXPECT_LT(found->rms_m, rms(nearby));
  }
}

TEST(Alignment, NeverMirrors) {
  RandomPoses random(24);
  std::vector<Vec3> points, mirrored;
  for (int i = 0; i < 10; ++i) {
    points.push_back(random.vector(1.0));
    mirrored.push_back(points.back().cwiseProduct(Vec3(1.0, 1.0, -1.0)));
  }
  const std::optional<Alignment> found = align_points(points, mirrored);
  ASSERT_TRUE(found);
  EXPECT_NEAR(found->T_a_b.rotation().determinant(), 1.0, 1e-12);
  EXPECT_GT(found->rms_m, 0.1);
}

TEST(Alignment, PointsOfAPlaneAreEnough) {
  RandomPoses random(25);
  const SE3 T = random.pose(3.0);
  std::vector<Vec3> a, b;
  for (int i = 0; i < 6; ++i) {
    b.push_back(random.vector(1.0).cwiseProduct(Vec3(1.0, 1.0, 0.0)));
    a.push_back(T * b.back());
  }
  const std::optional<Alignment> found = align_points(a, b);
  ASSERT_TRUE(found);
  EXPECT_NEAR((found->T_a_b.matrix() - T.matrix()).norm(), 0.0, 1e-9);
  EXPECT_NEAR(found->spread_m()(2), 0.0, 1e-7);
  EXPECT_GT(found->spread_m()(1), 0.1);
}

TEST(Alignment, RefusesDegenerateInput) {
  const std::vector<Vec3> line = {{0, 0, 0}, {1, 1, 1}, {2, 2, 2}, {5, 5, 5}};
  const std::vector<Vec3> point(4, Vec3(1, 2, 3));
  std::vector<Vec3> bad = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, std::nan("")}};
  const std::vector<Vec3> good = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  EXPECT_TRUE(align_points(good, good));
  EXPECT_FALSE(align_points(line, line));
  EXPECT_FALSE(align_points(point, point));
  EXPECT_FALSE(align_points(good, bad));
  EXPECT_FALSE(align_points(good, {{0, 0, 0}, {1, 0, 0}}));
  EXPECT_FALSE(align_points({{0, 0, 0}, {1, 0, 0}}, {{0, 0, 0}, {1, 0, 0}}));
}

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

/// so3_exp(v + d) = so3_exp(v) so3_exp(right_jacobian(v) d), and so3_log takes it back; from zero to near a half turn.
TEST(Lie, RightJacobianAndItsInverse) {
  Random random(8);
  for (const double angle : {0.0, 1e-7, 1e-4, 0.01, 1.0, 3.0}) {
    const Vec3 v = angle * random.normal3().normalized(), d = 1e-6 * random.normal3();
    const Vec3 step = so3_log(so3_exp(v).conjugate() * so3_exp(v + d));
    EXPECT_LT((right_jacobian(v) * d - step).norm(), 1e-10) << angle;
    EXPECT_LT((right_jacobian(v) * right_jacobian_inverse(v) - Mat3::Identity()).norm(), 1e-9) << angle;
  }
}

TEST(Lie, QuaternionByRotation) {
  Random random(9);
  const Quaternion q = so3_exp(random.normal3());
  const Vec3 d = 1e-6 * random.normal3();
  EXPECT_LT(((so3_exp(d) * q).coeffs() - q.coeffs() - 0.5 * quaternion_by_rotation(q) * d).norm(), 1e-10);
}

}  // namespace
}  // namespace semantic_topo_loop::core
