#include "semantic_topo_loop/geometry/alignment.h"

#include <gtest/gtest.h>

#include "semantic_topo_loop/geometry/lie.h"
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
  EXPECT_NEAR(found->spread_m(2), 0.0, 1e-7);
  EXPECT_GT(found->spread_m(1), 0.1);
}

TEST(Alignment, WeightsCountPointsSeveralTimes) {
  RandomPoses random(26);
  Cloud cloud = make_cloud(&random, random.pose(1.0), 1.0, 8, 0.1);
  const std::optional<Alignment> weighted = align_points(cloud.a, cloud.b, false, {1, 1, 3, 1, 1, 0, 1, 1});
  Cloud repeated = cloud;
  for (int i = 0; i < 2; ++i) {
    repeated.a.push_back(cloud.a[2]);
    repeated.b.push_back(cloud.b[2]);
  }
  repeated.a.erase(repeated.a.begin() + 5);
  repeated.b.erase(repeated.b.begin() + 5);
  const std::optional<Alignment> plain = align_points(repeated.a, repeated.b);
  ASSERT_TRUE(weighted && plain);
  EXPECT_NEAR((weighted->T_a_b.matrix() - plain->T_a_b.matrix()).norm(), 0.0, 1e-9);
  EXPECT_NEAR(weighted->rms_m, plain->rms_m, 1e-12);
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
  EXPECT_FALSE(align_points(good, good, false, {1, 1}));
  EXPECT_FALSE(align_points(good, good, false, {0, 0, 0, 0}));
}

}  // namespace
}  // namespace semantic_topo_loop::core
