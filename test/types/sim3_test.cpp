#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>

#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/types/transform.h"
#include "support/random_poses.h"

namespace semantic_topo_loop::core {
namespace {

Sim3 random_similarity(RandomPoses* random) {
  const SE3 T = random->pose(3.0);
  return Sim3(T, std::exp(random->uniform(-1.0, 1.0)));
}

Mat4 matrix(const Sim3& S) {
  Mat4 m = S.T.matrix();
  m.topLeftCorner<3, 3>() *= S.scale;
  return m;
}

TEST(Sim3, ProductInverseAndPointsAgreeWithMatrices) {
  RandomPoses random(1);
  for (int i = 0; i < 50; ++i) {
    const Sim3 a = random_similarity(&random), b = random_similarity(&random);
    const Vec3 p = random.vector(2.0);
    EXPECT_NEAR((matrix(a * b) - matrix(a) * matrix(b)).norm(), 0.0, 1e-11);
    EXPECT_NEAR((matrix(a.inverse()) - matrix(a).inverse()).norm(), 0.0, 1e-10);
    EXPECT_NEAR((a * p - (matrix(a) * p.homogeneous()).head<3>()).norm(), 0.0, 1e-11);
  }
}

/// What keeps every run with a fixed scale as it was.
TEST(Sim3, WithScaleOneItIsTheRigidTransformToTheLastBit) {
  RandomPoses random(3);
  for (int i = 0; i < 50; ++i) {
    const SE3 a = random.pose(3.0), b = random.pose(3.0);
    const auto expect_equal = [](const SE3& rigid, const SE3& other) {
      EXPECT_EQ(rigid.t, other.t);
      EXPECT_EQ(rigid.q.coeffs(), other.q.coeffs());
    };
    expect_equal(a * b, Sim3(a).pose(b));
    expect_equal(a * b, (Sim3(a) * Sim3(b)).T);
    expect_equal(a.inverse(), Sim3(a).inverse().T);
  }
}

TEST(Sim3, TheScaleOfAPoseStretchesItsPlaceAndLeavesItsDirection) {
  const Sim3 S(SE3(so3_exp(Vec3(0.0, 0.0, 0.5 * kPi)), Vec3(1.0, 0.0, 0.0)), 2.0);
  const SE3 pose = S.pose(SE3(Quaternion::Identity(), Vec3(3.0, 0.0, 0.0)));
  EXPECT_NEAR((pose.t - Vec3(1.0, 6.0, 0.0)).norm(), 0.0, 1e-12);
  EXPECT_NEAR(rotation_angle(pose.q, S.T.q), 0.0, 1e-7);
}

TEST(Sim3, KnowsWhetherItIsFinite) {
  EXPECT_TRUE(Sim3().is_finite());
  EXPECT_FALSE(Sim3(SE3(), 0.0).is_finite());
  EXPECT_FALSE(Sim3(SE3(), std::nan("")).is_finite());
  EXPECT_FALSE(Sim3(SE3(Quaternion::Identity(), Vec3(HUGE_VAL, 0.0, 0.0))).is_finite());
}

}  // namespace
}  // namespace semantic_topo_loop::core
