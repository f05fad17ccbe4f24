#include "semantic_topo_loop/geometry/quadric.h"

#include <gtest/gtest.h>

#include "semantic_topo_loop/types/camera.h"
#include "support/random_poses.h"

namespace semantic_topo_loop::core {
namespace {

Camera test_camera() { return {520.0, 515.0, 322.0, 241.0, 640, 480, {}}; }

/// An ellipsoid in front of a random camera, wholly beyond its principal plane.
struct View {
  SE3 T_world_camera;
  Ellipsoid ellipsoid;
  Mat34 P;
};

View random_view(RandomPoses* random) {
  View view;
  view.T_world_camera = random->pose(2.0);
  view.ellipsoid.semi_axes = Vec3(random->uniform(0.02, 0.4), random->uniform(0.02, 0.4), random->uniform(0.02, 0.4));
  const Vec3 center_camera(random->uniform(-0.8, 0.8), random->uniform(-0.6, 0.6), random->uniform(0.6, 4.0));
  view.ellipsoid.T_world_quadric = SE3(random->rotation(), view.T_world_camera * center_camera);
  view.P = projection_matrix(test_camera(), view.T_world_camera);
  return view;
}

/// The box of densely sampled points of the surface.
Box sampled_box(const View& view) {
  Box box{1e9, 1e9, -1e9, -1e9};
  constexpr int kSteps = 400;
  for (int i = 0; i <= kSteps; ++i) {
    for (int j = 0; j < 2 * kSteps; ++j) {
      const double theta = kPi * i / kSteps, phi = kPi * j / kSteps;
      const Vec3 unit(std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi), std::cos(theta));
      const Vec3 point = view.ellipsoid.T_world_quadric * unit.cwiseProduct(view.ellipsoid.semi_axes);
      const Vec3 image = view.P * point.homogeneous();
      const Vec2 pixel = image.hnormalized();
      box = {std::min(box.x1, pixel.x()), std::min(box.y1, pixel.y()), std::max(box.x2, pixel.x()),
             std::max(box.y2, pixel.y())};
    }
  }
  return box;
}

TEST(Quadric, BoxBoundsTheSampledSurface) {
  RandomPoses random(11);
  for (int i = 0; i < 20; ++i) {
    const View view = random_view(&random);
    const std::optional<Box> box = project_box(view.ellipsoid, view.P);
    ASSERT_TRUE(box);
    const Box sampled = sampled_box(view);
    // Samples lie inside, and the nearest one misses the edge by the second order of the step.
    const double slack = 1e-4 * std::max(sampled.width(), sampled.height());
    EXPECT_NEAR((box->edges() - sampled.edges()).cwiseAbs().maxCoeff(), 0.0, slack);
    EXPECT_LE(box->x1, sampled.x1 + 1e-9);
    EXPECT_LE(box->y1, sampled.y1 + 1e-9);
    EXPECT_GE(box->x2, sampled.x2 - 1e-9);
    EXPECT_GE(box->y2, sampled.y2 - 1e-9);
  }
}

TEST(Quadric, BothWaysToTheBoxAgree) {
  RandomPoses random(12);
  for (int i = 0; i < 200; ++i) {
    const View view = random_view(&random);
    const std::optional<Conic> conic = project(view.ellipsoid.dual(), view.P);
    ASSERT_TRUE(conic);
    EXPECT_NEAR((*conic)(2, 2), -1.0, 1e-12);
    const std::optional<Box> by_conic = bounding_box(*conic), direct = project_box(view.ellipsoid, view.P);
    ASSERT_TRUE(by_conic && direct);
    EXPECT_NEAR((by_conic->edges() - direct->edges()).norm(), 0.0, 1e-6);
  }
}

TEST(Quadric, SphereOnTheAxisHasTheTextbookOutline) {
  const Camera camera{500.0, 500.0, 320.0, 240.0, 640, 480, {}};
  Ellipsoid sphere;
  sphere.T_world_quadric.t = Vec3(0.0, 0.0, 2.0);
  sphere.semi_axes = Vec3::Constant(0.5);
  const std::optional<Box> box = project_box(sphere, projection_matrix(camera, SE3()));
  ASSERT_TRUE(box);
  const double radius = 500.0 * 0.5 / std::sqrt(2.0 * 2.0 - 0.5 * 0.5);
  EXPECT_NEAR((box->edges() - Vec4(320.0 - radius, 240.0 - radius, 320.0 + radius, 240.0 + radius)).norm(), 0.0, 1e-9);
}

TEST(Quadric, NotSeenFromBehindInsideOrAcrossThePrincipalPlane) {
  const Mat34 P = projection_matrix(test_camera(), SE3());
  Ellipsoid ellipsoid;
  ellipsoid.semi_axes = Vec3(0.3, 0.2, 0.4);
  for (const double z : {-2.0, -0.2, 0.0, 0.1, 0.39}) {
    ellipsoid.T_world_quadric.t = Vec3(0.05, 0.0, z);
    EXPECT_FALSE(project_box(ellipsoid, P)) << z;
    EXPECT_FALSE(project(ellipsoid.dual(), P)) << z;
  }
  ellipsoid.T_world_quadric.t.z() = 0.45;
  EXPECT_TRUE(project_box(ellipsoid, P));
  EXPECT_TRUE(project(ellipsoid.dual(), P));
}

TEST(Quadric, NotANumberIsNotSeen) {
  const Mat34 P = projection_matrix(test_camera(), SE3());
  Ellipsoid ellipsoid;
  ellipsoid.T_world_quadric.t = Vec3(0.0, std::nan(""), 2.0);
  EXPECT_FALSE(project_box(ellipsoid, P));
  EXPECT_FALSE(project(ellipsoid.dual(), P));
}

TEST(Quadric, TangentPlanesLieOnTheDual) {
  RandomPoses random(13);
  for (int i = 0; i < 50; ++i) {
    const Ellipsoid ellipsoid = random_view(&random).ellipsoid;
    const Vec3 normal_local = random.vector(1.0).normalized();
    const double support = normal_local.cwiseProduct(ellipsoid.semi_axes).norm();
    const Vec3 normal = ellipsoid.T_world_quadric.q * normal_local;
    Vec4 plane;
    plane << normal, -(normal.dot(ellipsoid.center()) + support);
    EXPECT_NEAR(plane.dot(ellipsoid.dual() * plane), 0.0, 1e-12);
  }
}

TEST(Quadric, RadiusKeepsTheVolume) {
  Ellipsoid ellipsoid;
  ellipsoid.semi_axes = Vec3(0.1, 0.2, 0.4);
  EXPECT_NEAR(std::pow(ellipsoid.radius(), 3.0), 0.008, 1e-15);
}

}  // namespace
}  // namespace semantic_topo_loop::core
