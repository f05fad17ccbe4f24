#include "loop/submap/surface_alignment.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <memory>
#include <random>
#include <vector>

#include "geometry/depth_points.h"
#include "loop/submap/observation_window.h"
#include "loop/submap/submap_refiner.h"
#include "loop/submap/surfels.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/types/camera.h"
#include "support/look_at.h"

namespace semantic_topo_loop::core {
namespace {

using Solid = Eigen::AlignedBox3d;

const Camera kCamera{262.5, 262.5, 159.5, 119.5, 320, 240, {}};

Solid solid(const Vec3& low, const Vec3& high) { return {low, high}; }

/// A floor and two walls that meet in a corner, a table and a cupboard.
std::vector<Solid> corner() {
  return {solid(Vec3(-4, -4, -0.1), Vec3(2.1, 2.1, 0)), solid(Vec3(2, -4, 0), Vec3(2.1, 2.1, 3)),
          solid(Vec3(-4, 2, 0), Vec3(2.1, 2.1, 3)), solid(Vec3(0.2, 0.3, 0), Vec3(1.2, 1.0, 0.75)),
          solid(Vec3(1.5, -1.2, 0), Vec3(2.0, -0.4, 1.4))};
}

std::vector<Solid> bare_wall() { return {solid(Vec3(2, -9, -9), Vec3(2.1, 9, 9))}; }

/// Depth along the ray, which has depth 1, to the first solid.
double depth(const std::vector<Solid>& scene, const SE3& T_world_camera, const Vec3& ray_camera) {
  const Vec3 ray = T_world_camera.q * ray_camera;
  double nearest = std::numeric_limits<double>::infinity();
  for (const Solid& box : scene) {
    const Vec3 low = (box.min() - T_world_camera.t).cwiseQuotient(ray);
    const Vec3 high = (box.max() - T_world_camera.t).cwiseQuotient(ray);
    const double enter = low.cwiseMin(high).maxCoeff(), leave = low.cwiseMax(high).minCoeff();
    if (enter > 0.0 && enter < leave) nearest = std::min(nearest, enter);
  }
  return nearest;
}

std::vector<Vec3> look(const std::vector<Solid>& scene, const SE3& T_world_camera, std::mt19937_64* random) {
  std::normal_distribution<double> normal;
  std::vector<Vec3> points;
  for (int v = 2; v < kCamera.height; v += 4) {
    for (int u = 2; u < kCamera.width; u += 4) {
      const Vec3 ray = kCamera.ray(Vec2(u, v));
      const double z = depth(scene, T_world_camera, ray);
      if (std::isfinite(z)) points.push_back(ray * (z + depth_sigma_m(z) * normal(*random)));
    }
  }
  return points;
}

/// A submap without objects: what a camera sees that moves by half a metre about `eye`.
struct View {
  LocalMap map;
  SE3 T_world_anchor;
};

View view(const std::vector<Solid>& scene, const Vec3& eye, const Vec3& target, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  ObservationWindow window(15.0, 0.0, ClassTable());
  for (int k = 0; k < 9; ++k) {
    Frame frame;
    frame.stamp_ns = k * 600'000'000LL;
    frame.camera = kCamera;
    const Vec3 offset(0.06 * (k - 4), -0.04 * (k - 4), 0.05 * std::sin(k));
    frame.T_odom_camera = testing::look_at(eye + offset, target + 0.5 * offset);
    frame.points_camera = std::make_shared<const std::vector<Vec3>>(look(scene, frame.T_odom_camera, &random));
    window.push(frame, AssociationFrame());
  }
  View result;
  result.T_world_anchor = window.frames()[4].T_odom_camera;
  const SE3 T_anchor_world = result.T_world_anchor.inverse();
  for (const ObservedFrame& observed : window.frames()) {
    const SE3 T_local_camera = T_anchor_world * observed.T_odom_camera;
    LocalFrame frame;
    frame.R_camera_local = T_local_camera.rotation().transpose();
    frame.position = T_local_camera.t;
    frame.t_camera_local = -frame.R_camera_local * frame.position;
    frame.image = observed.image;
    result.map.check_frames.push_back(static_cast<int>(result.map.frames.size()));
    result.map.frames.push_back(frame);
  }
  result.map.surfels = make_surfels(window.frames(), T_anchor_world);
  return result;
}

SE3 true_pose(const View& a, const View& b) { return a.T_world_anchor.inverse() * b.T_world_anchor; }

Vec6 random_error(double translation_m, double rotation_rad, std::mt19937_64* random) {
  std::normal_distribution<double> normal;
  Vec6 error;
  for (int i = 0; i < 6; ++i) error(i) = (i < 3 ? translation_m : rotation_rad) / std::sqrt(3.0) * normal(*random);
  return error;
}

Mat6 isotropic(double translation_m, double rotation_rad) {
  Vec6 variance;
  variance << Vec3::Constant(translation_m * translation_m / 3.0), Vec3::Constant(rotation_rad * rotation_rad / 3.0);
  return variance.asDiagonal();
}

constexpr double kStart_m = 0.15, kStart_rad = 0.08;

TEST(SurfaceAlignment, ACornerGivesThePoseAndItsCovariance) {
  double nees = 0.0;
  constexpr int kSeeds = 12;
  for (int seed = 0; seed < kSeeds; ++seed) {
    std::mt19937_64 random(static_cast<std::uint64_t>(seed));
    const View a = view(corner(), Vec3(-1.2, -0.8, 1.4), Vec3(1.2, 1.0, 0.6), random());
    const View b = view(corner(), Vec3(-0.6, -1.5, 1.6), Vec3(1.3, 0.6, 0.5), random());
    ASSERT_TRUE(a.map.surfels && b.map.surfels);
    EXPECT_LE(a.map.surfels->size() * sizeof(Surfel), 50'000u);
    const SE3 truth = true_pose(a, b);
    const SE3 start = truth * se3_exp(random_error(kStart_m, kStart_rad, &random));
    const auto aligned = align_surfaces(a.map, b.map, start, isotropic(kStart_m, kStart_rad));
    ASSERT_TRUE(aligned.has_value());
    const Vec6 error = se3_log(truth.inverse() * aligned->T_a_b);
    EXPECT_LT(error.head<3>().norm(), 0.01) << seed;
    EXPECT_LT(error.tail<3>().norm(), radians(0.4)) << seed;
    nees += error.dot(aligned->covariance.ldlt().solve(error)) / kSeeds;
    const SurfaceAgreement agreement = compare_surfaces(a.map, b.map, aligned->T_a_b);
    EXPECT_GT(agreement.judged, 500);
    EXPECT_LT(agreement.contradicted, 0.03 * agreement.judged);
  }
  // Six where the stated covariance is true. The odometry within a submap is perfect here, but not in the statement.
  EXPECT_GT(nees, 0.1);
  EXPECT_LT(nees, 9.0);
}

TEST(SurfaceAlignment, WhatABareWallLeavesFreeStaysAsItWas) {
  std::mt19937_64 random(1);
  const View a = view(bare_wall(), Vec3(0.0, 0.0, 0.0), Vec3(2.0, 0.1, 0.0), 1);
  const View b = view(bare_wall(), Vec3(-0.3, 0.2, 0.1), Vec3(2.0, 0.2, 0.2), 2);
  const SE3 truth = true_pose(a, b);
  Vec6 error;
  error << 0.08, -0.06, 0.07, 0.03, -0.02, 0.05;  // across, down, ahead; about the same axes of b's camera
  const Mat6 covariance = isotropic(kStart_m, kStart_rad);
  const auto aligned = align_surfaces(a.map, b.map, truth * se3_exp(error), covariance);
  ASSERT_TRUE(aligned.has_value());
  const Vec3 wall_normal = b.T_world_anchor.q.conjugate() * Vec3::UnitX();
  const Vec6 left = se3_log(truth.inverse() * aligned->T_a_b);
  const Vec3 along = left.head<3>() - wall_normal * wall_normal.dot(left.head<3>());
  const Vec3 along_before = error.head<3>() - wall_normal * wall_normal.dot(error.head<3>());
  EXPECT_LT(std::abs(wall_normal.dot(left.head<3>())), 0.01);
  EXPECT_LT((along - along_before).norm(), 0.02);
  EXPECT_NEAR(wall_normal.dot(left.tail<3>()), wall_normal.dot(error.tail<3>()), 0.005);
  EXPECT_LT(left.tail<3>().cross(wall_normal).norm(), radians(0.5));
  const Mat3 position = aligned->covariance.topLeftCorner<3, 3>();
  EXPECT_LT(std::sqrt(wall_normal.dot(position * wall_normal)), 0.03);
  EXPECT_GT(std::sqrt(position.trace()), 0.8 * kStart_m * std::sqrt(2.0 / 3.0));
}

TEST(SurfaceAlignment, SurfacesThatOneSideSeesThroughContradict) {
  std::vector<Solid> other = corner();
  other.push_back(solid(Vec3(0.0, -4, 0), Vec3(0.1, 2.1, 3)));  // a wall before the corner
  const View a = view(corner(), Vec3(-1.2, -0.8, 1.4), Vec3(1.2, 1.0, 0.6), 1);
  const View b = view(other, Vec3(-1.5, -1.0, 1.5), Vec3(1.3, 0.9, 0.5), 2);
  const SurfaceAgreement agreement = compare_surfaces(a.map, b.map, true_pose(a, b));
  EXPECT_GT(agreement.contradicted, 0.5 * agreement.judged);
}

/// Surfels of a floor, so far apart in both directions.
std::vector<Surfel> floor_of(int columns, int rows, float spacing_m, float shift_m) {
  std::vector<Surfel> surfels;
  for (int i = 0; i < columns * rows; ++i) {
    const auto column = static_cast<float>(i % columns), row = static_cast<float>(i / columns);
    surfels.push_back({{spacing_m * column + shift_m, spacing_m * row, 0.0F}, Eigen::Vector3f::UnitZ()});
  }
  return surfels;
}

LocalMap map_of(const std::vector<Surfel>& surfels) {
  LocalMap map;
  map.surfels = std::make_shared<const std::vector<Surfel>>(surfels);
  return map;
}

TEST(SurfaceAlignment, PartnersAreNearInWideSubmapsToo) {
  std::vector<Surfel> wide = floor_of(12, 12, 0.5F, 0.0F);
  const LocalMap between = map_of(floor_of(12, 12, 0.5F, 0.25F));
  EXPECT_FALSE(align_surfaces(map_of(wide), between, SE3(), isotropic(0.01, 0.01)).has_value());
  wide.push_back({{25.0F, 0.0F, 0.0F}, Eigen::Vector3f::UnitZ()});
  EXPECT_FALSE(align_surfaces(map_of(wide), between, SE3(), isotropic(0.01, 0.01)).has_value());
}

TEST(SurfaceAlignment, FewMatchesAreNoAnswer) {
  const LocalMap many = map_of(floor_of(30, 30, 0.1F, 0.0F)), enough = map_of(floor_of(12, 9, 0.1F, 0.0F));
  EXPECT_TRUE(align_surfaces(many, enough, SE3(), isotropic(0.01, 0.01)).has_value());
  EXPECT_FALSE(align_surfaces(many, map_of(floor_of(11, 9, 0.1F, 0.0F)), SE3(), isotropic(0.01, 0.01)).has_value());
}

TEST(SurfaceAlignment, TooLittleIsNoAnswer) {
  const View a = view(corner(), Vec3(-1.2, -0.8, 1.4), Vec3(1.2, 1.0, 0.6), 1);
  LocalMap none = a.map;
  none.surfels = std::make_shared<const std::vector<Surfel>>();
  EXPECT_FALSE(align_surfaces(a.map, none, SE3(), isotropic(0.1, 0.1)).has_value());
  EXPECT_FALSE(align_surfaces(none, a.map, SE3(), isotropic(0.1, 0.1)).has_value());
  EXPECT_EQ(compare_surfaces(a.map, none, SE3()).judged, 0);
  const SE3 far(Quaternion::Identity(), Vec3(100.0, 0.0, 0.0));
  EXPECT_FALSE(align_surfaces(a.map, a.map, far, isotropic(0.1, 0.1)).has_value());
}

}  // namespace
}  // namespace semantic_topo_loop::core
