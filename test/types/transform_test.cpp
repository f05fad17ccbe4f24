#include "semantic_topo_loop/types/transform.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>

#include "semantic_topo_loop/geometry/lie.h"
#include "support/random_poses.h"

namespace semantic_topo_loop::core {
namespace {

TEST(Se3, MapsPointsAsItsMatrixDoes) {
  RandomPoses random(1);
  for (int i = 0; i < 50; ++i) {
    const SE3 T = random.pose(5.0);
    const Vec3 p = random.vector(3.0);
    const Vec4 mapped = T.matrix() * p.homogeneous();
    EXPECT_NEAR((T * p - mapped.head<3>()).norm(), 0.0, 1e-12);
  }
}

TEST(Se3, ProductAndInverseAgreeWithMatrices) {
  RandomPoses random(2);
  for (int i = 0; i < 50; ++i) {
    const SE3 a = random.pose(5.0), b = random.pose(5.0);
    EXPECT_NEAR(((a * b).matrix() - a.matrix() * b.matrix()).norm(), 0.0, 1e-11);
    EXPECT_NEAR((a.inverse().matrix() - a.matrix().inverse()).norm(), 0.0, 1e-11);
    EXPECT_NEAR(((a * a.inverse()).matrix() - Mat4::Identity()).norm(), 0.0, 1e-11);
  }
}

TEST(Se3, HatIsTheCrossProduct) {
  const Vec3 a(1.0, -2.0, 3.0), b(0.5, 4.0, -1.0);
  EXPECT_EQ(hat(a) * b, a.cross(b));
}

TEST(Se3, ExponentialOfKnownRotations) {
  const Quaternion quarter = so3_exp(Vec3(0.0, 0.0, kPi / 2.0));
  EXPECT_NEAR((quarter * Vec3::UnitX() - Vec3::UnitY()).norm(), 0.0, 1e-15);
  EXPECT_EQ(so3_exp(Vec3::Zero()).coeffs(), Quaternion::Identity().coeffs());
}

TEST(Se3, LogarithmInvertsTheExponential) {
  RandomPoses random(3);
  for (const double angle : {0.0, 1e-12, 1e-8, 1e-6, 1e-4, 0.1, 1.0, 3.0, kPi - 1e-6}) {
    for (int i = 0; i < 10; ++i) {
      const Vec3 v = angle * random.vector(1.0).normalized();
      EXPECT_NEAR((so3_log(so3_exp(v)) - v).norm(), 0.0, 1e-9) << angle;
      // q and -q are the same rotation.
      const Quaternion q = so3_exp(v);
      EXPECT_NEAR((so3_log(Quaternion(-q.w(), -q.x(), -q.y(), -q.z())) - v).norm(), 0.0, 1e-9) << angle;
    }
  }
}

TEST(Se3, LogarithmAtHalfATurn) {
  EXPECT_NEAR(so3_log(so3_exp(Vec3(kPi, 0.0, 0.0))).norm(), kPi, 1e-12);
  EXPECT_NEAR(so3_log(so3_exp(Vec3(0.0, 1.5 * kPi, 0.0))).y(), -0.5 * kPi, 1e-12);
}

TEST(Se3, TangentIsTranslationThenRotation) {
  RandomPoses random(4);
  for (int i = 0; i < 20; ++i) {
    const SE3 T = random.pose(2.0);
    const Vec6 tangent = se3_log(T);
    EXPECT_EQ(Vec3(tangent.head<3>()), T.t);
    EXPECT_NEAR((se3_exp(tangent).matrix() - T.matrix()).norm(), 0.0, 1e-12);
  }
}

TEST(Se3, RotationAngle) {
  const Quaternion a = so3_exp(Vec3(0.3, -0.2, 0.9));
  const Quaternion b = a * so3_exp(Vec3(0.0, 0.4, 0.0));
  EXPECT_NEAR(rotation_angle(a, b), 0.4, 1e-12);
  EXPECT_NEAR(rotation_angle(a, Quaternion(-b.w(), -b.x(), -b.y(), -b.z())), 0.4, 1e-12);
  EXPECT_EQ(rotation_angle(Quaternion::Identity(), Quaternion::Identity()), 0.0);
}

TEST(Se3, InterpolationMeetsItsEndsAndTheMiddle) {
  const SE3 a(Quaternion::Identity(), Vec3(1.0, 0.0, 0.0));
  const SE3 b(so3_exp(Vec3(0.0, 0.0, 1.0)), Vec3(3.0, 2.0, 0.0));
  EXPECT_NEAR((interpolate(a, b, 0.0).matrix() - a.matrix()).norm(), 0.0, 1e-15);
  EXPECT_NEAR((interpolate(a, b, 1.0).matrix() - b.matrix()).norm(), 0.0, 1e-15);
  const SE3 middle = interpolate(a, b, 0.5);
  EXPECT_NEAR((middle.t - Vec3(2.0, 1.0, 0.0)).norm(), 0.0, 1e-15);
  EXPECT_NEAR((so3_log(middle.q) - Vec3(0.0, 0.0, 0.5)).norm(), 0.0, 1e-12);
}

TEST(Se3, InterpolationTakesTheShorterWay) {
  const Quaternion q = so3_exp(Vec3(0.2, 0.0, 0.0));
  const SE3 a, b(Quaternion(-q.w(), -q.x(), -q.y(), -q.z()), Vec3::Zero());
  EXPECT_NEAR(rotation_angle(interpolate(a, b, 0.5).q, Quaternion::Identity()), 0.1, 1e-12);
}

TEST(Se3, KnowsWhetherItIsFinite) {
  EXPECT_TRUE(SE3().is_finite());
  EXPECT_FALSE(SE3(Quaternion::Identity(), Vec3(0.0, std::nan(""), 0.0)).is_finite());
  EXPECT_FALSE(SE3(Quaternion(HUGE_VAL, 0.0, 0.0, 0.0), Vec3::Zero()).is_finite());
}

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
