#include <gtest/gtest.h>

#include <bitset>
#include <opencv2/imgproc.hpp>
#include <random>

#include "frontend/bundle_adjustment.h"
#include "frontend/depth_registration.h"
#include "frontend/image_features.h"
#include "frontend/nearest_depth.h"
#include "frontend/pose_solver.h"
#include "frontend/tracking_map.h"
#include "semantic_topo_loop/frontend/rgbd_frontend.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

const Camera kKinect{525.0, 525.0, 319.5, 239.5, 640, 480, {}};

class Noise {
 public:
  double normal() { return normal_(engine_); }
  double uniform(double low, double high) { return low + (high - low) * uniform_(engine_); }
  std::uint64_t bits() { return engine_(); }

 private:
  std::mt19937_64 engine_{7};
  std::normal_distribution<double> normal_;
  std::uniform_real_distribution<double> uniform_;
};

/// A point in the image, measured with errors of one sigma.
PoseObservation observe(const SE3& T_camera_map, Noise* noise) {
  const double z = noise->uniform(0.8, 4.0);
  const Vec2 pixel(noise->uniform(20.0, 620.0), noise->uniform(20.0, 460.0));
  PoseObservation o;
  o.point_map = T_camera_map.inverse() * Vec3(z * kKinect.ray(pixel));
  o.depth_sigma_m = 0.002 * z * z;
  o.depth_m = z + o.depth_sigma_m * noise->normal();
  o.pixel_sigma = 1.3;
  o.pixel = pixel + o.pixel_sigma * Vec2(noise->normal(), noise->normal());
  return o;
}

const SE3 kPose(so3_exp(Vec3(0.2, -0.4, 0.1)), Vec3(0.3, -0.1, 0.5));

TEST(Descriptor, HammingCountsBits) {
  Noise noise;
  for (int i = 0; i < 100; ++i) {
    Descriptor a{}, b{};
    int expected = 0;
    for (std::size_t k = 0; k < a.size(); ++k) {
      a[k] = noise.bits();
      b[k] = i == 0 ? ~a[k] : noise.bits();  // all 256 bits at first
      expected += static_cast<int>(std::bitset<64>(a[k] ^ b[k]).count());
    }
    EXPECT_EQ(hamming(a, b), expected);
  }
}

/// The squared error in units of the stated covariance is on average the number of degrees of freedom, also where
/// pixels are off by more than their sigmas, as in a blurred image, of which those that are far off are left out.
TEST(PoseSolver, CovarianceIsThatOfTheErrors) {
  Noise noise;
  for (const double blur : {1.0, 1.5, 2.0}) {
    double sum = 0.0;
    constexpr int kRuns = 200;
    for (int run = 0; run < kRuns; ++run) {
      std::vector<PoseObservation> observations;
      for (int i = 0; i < 60; ++i) {
        observations.push_back(observe(kPose, &noise));
        const double more = 1.3 * std::sqrt(blur * blur - 1.0);
        observations.back().pixel += more * Vec2(noise.normal(), noise.normal());
      }
      const SE3 guess(kPose.q * so3_exp(Vec3(0.02, 0.01, -0.02)), kPose.t + Vec3(0.02, -0.03, 0.02));
      const std::optional<PoseEstimate> estimate = refine_pose(kKinect, guess, observations);
      ASSERT_TRUE(estimate);
      const Vec6 error = se3_log(kPose * estimate->T_camera_map.inverse());
      sum += error.dot(estimate->covariance.ldlt().solve(error));
    }
    EXPECT_GT(sum / kRuns, 5.0) << blur;
    EXPECT_LT(sum / kRuns, 10.0) << blur;
  }
}

TEST(PoseSolver, FindsAPoseAmongWrongMatches) {
  Noise noise;
  std::vector<PoseObservation> observations;
  for (int i = 0; i < 100; ++i) {
    observations.push_back(observe(kPose, &noise));
    if (i % 5 >= 2) observations.back().point_map = Vec3(noise.normal(), noise.normal(), noise.normal());
  }
  const std::optional<PoseEstimate> estimate = find_pose(kKinect, observations, 20);
  ASSERT_TRUE(estimate);
  EXPECT_LT((estimate->T_camera_map.t - kPose.t).norm(), 0.01);
  EXPECT_GE(estimate->inliers, 34);
  EXPECT_LE(estimate->inliers, 44);
  const std::optional<PoseEstimate> again = find_pose(kKinect, observations, 20);
  EXPECT_EQ(again->T_camera_map.t, estimate->T_camera_map.t);
  EXPECT_FALSE(find_pose(kKinect, observations, 60));
}

TEST(PoseSolver, WhatIsNotTrustedHasNoSayAndIsToldWhetherItFits) {
  Noise noise;
  const SE3 T_moved(so3_exp(Vec3(0.0, 0.0, 0.02)), Vec3(0.03, 0.02, 0.0));
  std::vector<PoseObservation> trusted, observations;
  for (int i = 0; i < 150; ++i) {
    PoseObservation o = observe(kPose, &noise);
    o.is_trusted = i < 50;
    if (i >= 100) o.point_map = T_moved * o.point_map;
    if (o.is_trusted) trusted.push_back(o);
    observations.push_back(o);
  }
  const std::optional<PoseEstimate> alone = refine_pose(kKinect, kPose, trusted);
  const std::optional<PoseEstimate> estimate = refine_pose(kKinect, kPose, observations);
  ASSERT_TRUE(alone && estimate);
  EXPECT_EQ(estimate->T_camera_map.t, alone->T_camera_map.t);
  EXPECT_EQ(estimate->covariance, alone->covariance);
  const auto agreeing = [&estimate](int from, int to) {
    return std::count(estimate->is_inlier.begin() + from, estimate->is_inlier.begin() + to, true);
  };
  EXPECT_GT(agreeing(50, 100), 40);
  EXPECT_LT(agreeing(100, 150), 10);
}

TEST(PoseSolver, ManyThatMovedAlikeDoNotPullIt) {
  Noise noise;
  std::vector<PoseObservation> observations;
  for (int i = 0; i < 100; ++i) {
    observations.push_back(observe(kPose, &noise));
    if (i % 5 < 2) observations.back().pixel += Vec2(15.0, 0.0);
  }
  const std::optional<PoseEstimate> estimate = refine_pose(kKinect, kPose, observations);
  ASSERT_TRUE(estimate);
  EXPECT_LT((estimate->T_camera_map.t - kPose.t).norm(), 0.005);
  EXPECT_LT(degrees(rotation_angle(estimate->T_camera_map.q, kPose.q)), 0.2);
}

TEST(PoseSolver, TooFewObservationsAreNoPose) {
  Noise noise;
  std::vector<PoseObservation> observations;
  for (int i = 0; i < 5; ++i) observations.push_back(observe(kPose, &noise));
  EXPECT_FALSE(refine_pose(kKinect, kPose, observations));
  EXPECT_FALSE(find_pose(kKinect, {}, 6));
}

/// A wall 3 m away with a hole in its depth to the right, and a box 2 m away to the left of the middle.
std::vector<Vec3> wall_with_box() {
  std::vector<Vec3> points;
  for (int v = 2; v < kKinect.height; v += 4) {
    for (int u = 2; u < kKinect.width; u += 4) {
      if (u > 500) continue;
      points.push_back((u > 200 && u < 300 ? 2.0 : 3.0) * kKinect.ray(Vec2(u, v)));
    }
  }
  return points;
}

TEST(NearestDepth, SeesThroughWhereNothingWas) {
  const NearestDepth depth(kKinect, wall_with_box());
  const auto sees_through = [&depth](double u, double z_m) {
    return depth.sees_through(kKinect, z_m * kKinect.ray(Vec2(u, 240.0)));
  };
  EXPECT_TRUE(sees_through(400.0, 2.5));
  EXPECT_FALSE(sees_through(400.0, 3.0)) << "the wall itself";
  EXPECT_FALSE(sees_through(400.0, 2.9)) << "as good as the wall";
  EXPECT_FALSE(sees_through(400.0, 3.5)) << "hidden by the wall";
  EXPECT_FALSE(sees_through(250.0, 2.0)) << "the box";
  EXPECT_TRUE(sees_through(250.0, 1.5));
  EXPECT_FALSE(sees_through(310.0, 2.0)) << "next to the box, whose outline is not known to a pixel";
  EXPECT_FALSE(sees_through(600.0, 1.0)) << "no depth there";
  EXPECT_FALSE(sees_through(-50.0, 1.0)) << "out of view";
  EXPECT_FALSE(sees_through(400.0, -1.0)) << "behind the camera";
  EXPECT_FALSE(NearestDepth().sees_through(kKinect, Vec3(0.0, 0.0, 1.0))) << "nothing is known";
}

/// A wide lens sees beyond the rectangle that its raw image fills.
TEST(NearestDepth, TheRawImageSaysWhatIsInView) {
  const Camera wide{450.0, 450.0, 320.0, 240.0, 640, 480, {-0.3, 0.1, 0.0, 0.0, 0.0}};
  for (const Vec2& raw : {Vec2(25.0, 240.0), Vec2(620.0, 460.0), Vec2(320.0, 2.0)}) {
    EXPECT_TRUE(pixel_in_view(wide, 2.0 * wide.ray(wide.undistort(raw)))) << raw.transpose();
  }
  EXPECT_FALSE(pixel_in_view(wide, 2.0 * wide.ray(wide.undistort(Vec2(-5.0, 240.0)))));
  EXPECT_FALSE(pixel_in_view(wide, Vec3(5.0, 0.0, 1.0))) << "the polynomial leads back into the image";
  const Vec3 at_the_side = wide.ray(wide.undistort(Vec2(25.0, 240.0)));
  EXPECT_TRUE(NearestDepth(wide, {3.0 * at_the_side}).sees_through(wide, at_the_side));
}

/// Features 40 pixels apart, which no point has yet.
TrackedFeatures features_at(int world, const std::vector<double>& depths_m) {
  TrackedFeatures image;
  image.section = {world, world};
  for (std::size_t i = 0; i < depths_m.size(); ++i) {
    ImageFeature feature;
    feature.pixel = Vec2(350.0 + 40.0 * static_cast<double>(i), 240.0);
    feature.depth_m = depths_m[i];
    feature.depth_sigma_m = 0.01;
    image.features.features.push_back(feature);
  }
  image.features.descriptors.resize(depths_m.size());
  image.features.index(kKinect);
  image.points.assign(depths_m.size(), -1);
  return image;
}

TEST(TrackingMap, WhatHasComeGivesNoPoints) {
  const FrontendOptions options;
  TrackingMap map(options);
  add_keyframe(features_at(0, {}), wall_with_box(), kKinect, &map);
  add_keyframe(features_at(0, {3.0, 1.5}), wall_with_box(), kKinect, &map);
  ASSERT_EQ(map.points().size(), 1U);
  EXPECT_NEAR(map.points().begin()->second.position.z(), 3.0, 1e-9);
  add_keyframe(features_at(1, {1.5}), wall_with_box(), kKinect, &map);
  EXPECT_EQ(map.points().size(), 2U) << "how another world lies to this one is not known";
}

TEST(TrackingMap, WhatWasLastSeenBeforeALossStaysToBeFoundAgain) {
  const FrontendOptions options;
  TrackingMap map(options);
  add_keyframe(features_at(0, {2.0, 2.0, 2.0}), {}, kKinect, &map);
  for (int i = 0; i < 3; ++i) add_keyframe(features_at(1, {2.0}), {}, kKinect, &map);
  EXPECT_NE(map.point(0), nullptr);
  for (int i = 0; i < 3; ++i) add_keyframe(features_at(0, {}), {}, kKinect, &map);
  EXPECT_EQ(map.point(0), nullptr) << "could be seen";
}

TEST(TrackingMap, AnImageCountsForWhatItSeesAndForWhatItMisses) {
  const FrontendOptions options;
  TrackingMap map(options);
  const TrackedFeatures first = features_at(0, {2.0, 2.0, 2.0});
  add_keyframe(first, {}, kKinect, &map);
  ASSERT_EQ(map.points().size(), 3U);
  TrackedFeatures image = first;
  image.points = {0, 1, -1};
  image.expected = {1, 2, 7};
  count_views(image, &map);
  for (const std::int64_t id : {0, 1, 2}) EXPECT_EQ(map.point(id)->expected, 2) << id;
  for (const std::int64_t id : {0, 1}) EXPECT_EQ(map.point(id)->found, 2) << id;
  EXPECT_EQ(map.point(2)->found, 1) << "looked for, and not there";
}

/// A camera that goes around points, with errors in the start values.
BundleProblem bundle(const Camera& seen_with, Noise* noise) {
  BundleProblem problem;
  constexpr int kPoses = 8, kPoints = 120;
  for (int i = 0; i < kPoses; ++i) {
    BundleProblem::Pose pose;
    pose.keyframe = i;
    pose.T_camera_map = SE3(so3_exp(Vec3(0.02 * i, 0.08 * i, 0.0)), Vec3(-0.1 * i, 0.02 * i, 0.03 * i));
    pose.is_fixed = i == 0;
    problem.poses.push_back(pose);
  }
  for (int i = 0; i < kPoints; ++i) {
    const Vec3 point(noise->uniform(-1.0, 1.0), noise->uniform(-0.8, 0.8), noise->uniform(1.5, 3.0));
    problem.points.push_back({i, point});
    for (std::size_t k = 0; k < problem.poses.size(); ++k) {
      const Vec3 p = problem.poses[k].T_camera_map * point;
      BundleProblem::View view;
      view.pose = k;
      view.point = static_cast<std::size_t>(i);
      view.observation.pixel = Vec2(seen_with.fx * p.x() / p.z() + seen_with.cx + 0.3 * noise->normal(),
                                    seen_with.fy * p.y() / p.z() + seen_with.cy + 0.3 * noise->normal());
      view.observation.depth_sigma_m = 0.003 * p.z() * p.z();
      view.observation.depth_m = p.z() + view.observation.depth_sigma_m * noise->normal();
      problem.views.push_back(view);
    }
  }
  return problem;
}

TEST(BundleAdjustment, RecoversPosesAndPoints) {
  Noise noise;
  const BundleProblem truth = bundle(kKinect, &noise);
  BundleProblem problem = truth;
  for (BundleProblem::Pose& pose : problem.poses) {
    if (!pose.is_fixed) pose.T_camera_map.t += 0.02 * Vec3(noise.normal(), noise.normal(), noise.normal());
  }
  for (BundleProblem::Point& point : problem.points) {
    point.position += 0.02 * Vec3(noise.normal(), noise.normal(), noise.normal());
  }
  problem.views[37].observation.pixel += Vec2(40.0, 0.0);
  solve(kKinect, 15, false, &problem);
  ASSERT_TRUE(problem.is_solved);
  for (std::size_t i = 0; i < problem.poses.size(); ++i) {
    EXPECT_LT((problem.poses[i].T_camera_map.t - truth.poses[i].T_camera_map.t).norm(), 0.003) << i;
  }
  EXPECT_EQ(problem.poses[0].T_camera_map.t, truth.poses[0].T_camera_map.t);
  EXPECT_TRUE(problem.views[37].is_outlier);
  EXPECT_FALSE(problem.views[36].is_outlier);
}

TEST(BundleAdjustment, FindsAWrongFocalLengthAndLeavesARightOne) {
  Noise noise;
  Camera wide = kKinect;
  wide.fx *= 0.9;
  wide.fy *= 0.9;
  const std::optional<FocalEstimate> of_wrong = estimate_focal_length(kKinect, bundle(wide, &noise));
  const std::optional<FocalEstimate> of_right = estimate_focal_length(kKinect, bundle(kKinect, &noise));
  ASSERT_TRUE(of_wrong && of_right);
  EXPECT_NEAR(of_wrong->log_factor, std::log(0.9), 0.01);
  EXPECT_GT(of_wrong->gain(), 0.1);
  EXPECT_NEAR(of_right->log_factor, 0.0, 0.005);
  EXPECT_LT(of_right->gain(), 0.001);
  // How well a focal length is determined is a matter of the views, not of how far off the stated one is.
  EXPECT_GT(of_right->information, 0.3 * of_wrong->information);
  EXPECT_LT(of_right->information, 3.0 * of_wrong->information);
}

TEST(FocalEstimate, OfSeveralWindowsIsThatOfTheirCostsTogether) {
  FocalEstimate sum{0.02, 30.0};
  sum += {-0.04, 10.0};
  EXPECT_NEAR(sum.log_factor, 0.005, 1e-12);
  EXPECT_NEAR(sum.information, 40.0, 1e-12);
  EXPECT_NEAR(sum.gain(), 0.001, 1e-12);
  FocalEstimate none;
  none += FocalEstimate();
  EXPECT_EQ(none.gain(), 0.0);
}

/// Rectangles in front of a wall, seen in depth and, by another camera beside it, in color.
/// @param shadow_px around each, where there is no depth
/// @param seen_depth_m null, or what depth the color image shows
RgbdImage rectangles(const DepthRegistration& registration, Noise* noise, double shadow_px = 0.0,
                     cv::Mat* seen_depth_m = nullptr) {
  RgbdImage image;
  image.gray = cv::Mat(kKinect.height, kKinect.width, CV_8UC1, cv::Scalar(120));
  image.depth_m = cv::Mat(kKinect.height, kKinect.width, CV_32FC1, cv::Scalar(3.5));
  if (seen_depth_m != nullptr) *seen_depth_m = image.depth_m.clone();
  for (int i = 0; i < 14; ++i) {
    const double z = 3.0 - 0.15 * i;  // the nearer ones are drawn over the others
    const Vec2 corner(noise->uniform(10.0, 560.0), noise->uniform(10.0, 420.0));
    const Vec2 size(noise->uniform(40.0, 120.0), noise->uniform(40.0, 120.0));
    const auto draw = [](cv::Mat* on, const Vec2& a, const Vec2& b, double value) {
      cv::rectangle(*on, cv::Point(static_cast<int>(std::lround(a.x())), static_cast<int>(std::lround(a.y()))),
                    cv::Point(static_cast<int>(std::lround(b.x())), static_cast<int>(std::lround(b.y()))),
                    cv::Scalar(value), cv::FILLED);
    };
    const Vec2 shadow = Vec2::Constant(shadow_px);
    draw(&image.depth_m, corner - shadow, corner + size + shadow, 0.0);
    draw(&image.depth_m, corner, corner + size, z);
    const Vec2 begin = registration.to_color(kKinect, corner, z),
               end = registration.to_color(kKinect, corner + size, z);
    draw(&image.gray, begin, end, i % 2 == 0 ? noise->uniform(0.0, 80.0) : noise->uniform(160.0, 255.0));
    if (seen_depth_m != nullptr) draw(seen_depth_m, begin, end, z);
  }
  return image;
}

/// @param factor by which the images have more pixels a side than a Kinect's
void expect_found_from_outlines(int factor) {
  Camera camera = kKinect;
  for (double* value : {&camera.fx, &camera.fy, &camera.cx, &camera.cy}) *value *= factor;
  camera.width *= factor;
  camera.height *= factor;
  DepthRegistration truth;
  truth.scale = 0.92;
  truth.shift_px = Vec2(2.0, -3.0);
  truth.parallax_px_m = Vec2(13.0, 0.0);
  RegistrationEstimator estimator(camera);
  Noise noise;
  for (int i = 0; i < 4; ++i) {
    RgbdImage image = rectangles(truth, &noise, 8.0);
    for (cv::Mat* pixels : {&image.gray, &image.depth_m}) {
      cv::resize(*pixels, *pixels, cv::Size(), factor, factor, cv::INTER_NEAREST);
    }
    estimator.add(image);
  }
  const std::optional<DepthRegistration> found = estimator.estimate();
  ASSERT_TRUE(found);
  truth.shift_px *= factor;
  truth.parallax_px_m *= factor;
  for (const Vec2& vga_pixel : {Vec2(50, 60), Vec2(600, 100), Vec2(320, 400)}) {
    const Vec2 pixel = factor * vga_pixel;
    for (const double z : {1.0, 3.0}) {
      EXPECT_LT((found->to_color(camera, pixel, z) - truth.to_color(camera, pixel, z)).norm(), 3.0 * factor);
      EXPECT_LT((found->to_depth(camera, found->to_color(camera, pixel, z), z) - pixel).norm(), 1e-9);
    }
  }
}

TEST(DepthRegistration, IsFoundFromOutlines) { expect_found_from_outlines(1); }
TEST(DepthRegistration, IsFoundFromOutlinesInWideImages) { expect_found_from_outlines(3); }

TEST(DepthRegistration, RegisteredDepthIsLeftAlone) {
  RegistrationEstimator estimator(kKinect);
  Noise noise;
  for (int i = 0; i < 4; ++i) estimator.add(rectangles({}, &noise));
  EXPECT_FALSE(estimator.estimate());
}

TEST(DepthRegistration, NoOutlinesSayNothing) {
  RegistrationEstimator estimator(kKinect);
  RgbdImage image;
  image.gray = cv::Mat(kKinect.height, kKinect.width, CV_8UC1, cv::Scalar(120));
  image.depth_m = cv::Mat(kKinect.height, kKinect.width, CV_32FC1, cv::Scalar(2.0));
  estimator.add(image);
  EXPECT_FALSE(estimator.estimate());
}

TEST(DepthRegistration, IsLookedForUntilThereAreOutlines) {
  DepthRegistration truth;
  truth.scale = 0.92;
  truth.shift_px = Vec2(2.0, -3.0);
  truth.parallax_px_m = Vec2(13.0, 0.0);
  constexpr int kBare = 100, kImages = 300;  // for longer than three seconds of a wall, or of things in the dark
  for (const bool is_dark : {false, true}) {
    Noise noise;
    RgbdFrontend frontend({}, kKinect);
    bool is_found = false;
    for (int i = 0; i < kImages && !is_found; ++i) {
      RgbdImage image = rectangles(truth, &noise);
      if (i < kBare) {
        if (is_dark) {
          cv::randn(image.gray, 5.0, 2.0);
        } else {
          image.gray = cv::Scalar(120);
          image.depth_m = cv::Scalar(3.5);
        }
      }
      image.stamp_ns = 1'000'000'000 + i * 33'333'333LL;
      is_found = frontend.track(image).is_recalibrated;
      if (i < kBare) {
        EXPECT_FALSE(is_found) << i;
      }
    }
    EXPECT_TRUE(is_found) << is_dark;
  }
}

const Camera kVga{500.0, 500.0, 320.0, 240.0, 640, 480, {}};

/// A light square, 1 m away, before a dark wall at 3 m.
RgbdImage square_before_wall() {
  RgbdImage image;
  image.gray = cv::Mat(480, 640, CV_8UC1, cv::Scalar(40));
  image.depth_m = cv::Mat(480, 640, CV_32FC1, cv::Scalar(3.0F));
  const cv::Rect square(200, 150, 200, 160);
  image.gray(square).setTo(200);
  image.depth_m(square).setTo(1.0F);
  return image;
}

TEST(SemiDensePoints, LieOnTheOutlineOfWhatIsInFront) {
  const std::vector<Eigen::Vector3f> points = semi_dense_points(square_before_wall(), kVga, {}, 3000);
  ASSERT_GT(points.size(), 40U);
  for (const Eigen::Vector3f& p : points) {
    EXPECT_FLOAT_EQ(p.z(), 1.0F);
    const double u = 500.0 * static_cast<double>(p.x() / p.z()) + 320.0,
                 v = 500.0 * static_cast<double>(p.y() / p.z()) + 240.0;
    const double outside = std::max({200.0 - u, u - 399.0, 150.0 - v, v - 309.0});
    EXPECT_LT(std::abs(outside), 2.0) << u << ' ' << v;
  }
  EXPECT_EQ(points, semi_dense_points(square_before_wall(), kVga, {}, 3000));
}

TEST(SemiDensePoints, AreNoMoreThanAskedForEvenOnNoise) {
  RgbdImage image = square_before_wall();
  cv::RNG random(1);
  random.fill(image.gray, cv::RNG::UNIFORM, 0, 255);
  for (const int count : {1, 100, 3000}) {
    const std::size_t points = semi_dense_points(image, kVga, {}, count).size();
    EXPECT_GT(points, 0U);
    EXPECT_LE(points, static_cast<std::size_t>(1.2 * count) + 2U);
  }
}

TEST(SemiDensePoints, OfBadImagesThereAreNone) {
  RgbdImage image = square_before_wall();
  image.depth_m.setTo(0.0F);
  EXPECT_TRUE(semi_dense_points(image, kVga, {}, 3000).empty()) << "no depth";
  image = square_before_wall();
  image.gray.setTo(0);
  EXPECT_TRUE(semi_dense_points(image, kVga, {}, 3000).empty()) << "black";
  image = square_before_wall();
  image.depth_m = image.depth_m(cv::Rect(0, 0, 320, 240));
  EXPECT_TRUE(semi_dense_points(image, kVga, {}, 3000).empty()) << "depth of another size";
  EXPECT_TRUE(semi_dense_points({}, kVga, {}, 3000).empty());
}

TEST(SemiDensePoints, HaveTheDepthThatTheFoundRegistrationPutsThere) {
  DepthRegistration truth;
  truth.scale = 0.92;
  truth.parallax_px_m = Vec2(13.0, 0.0);  // 7 px at 2 m
  RgbdFrontend frontend({}, kKinect);
  Noise noise;
  for (int i = 0; i < 13; ++i) {
    RgbdImage image = rectangles(truth, &noise);
    image.stamp_ns = i * 300'000'000LL;
    frontend.track(image);
  }
  cv::Mat seen_depth_m;
  const RgbdImage image = rectangles(truth, &noise, 0.0, &seen_depth_m);
  // An outline is that of the nearer of two surfaces.
  const auto right_share = [&](const std::vector<Eigen::Vector3f>& points) {
    int right = 0;
    for (const Eigen::Vector3f& point : points) {
      const Vec2 pixel = kKinect.pixel(point.cast<double>());
      const cv::Rect around(static_cast<int>(pixel.x()) - 3, static_cast<int>(pixel.y()) - 3, 7, 7);
      double nearest_m = 0.0;
      cv::minMaxLoc(seen_depth_m(around & cv::Rect(0, 0, kKinect.width, kKinect.height)), &nearest_m);
      right += std::abs(nearest_m - point.z()) < 0.01 ? 1 : 0;
    }
    return static_cast<double>(right) / static_cast<double>(points.size());
  };
  const std::vector<Eigen::Vector3f> points = frontend.keyframe_points(image, 3000).semi_dense;
  ASSERT_GT(points.size(), 200U);
  EXPECT_GT(right_share(points), 0.8);
  EXPECT_LT(right_share(semi_dense_points(image, kKinect, {}, 3000)), 0.6) << "the scene would not show the difference";
}

TEST(FindCorners, LookingForStrongOnesFirstChangesNothing) {
  constexpr int kThreshold = 7, kStrong = 20, kWanted = 60;
  Noise noise;
  const auto key = [](const cv::KeyPoint& corner) {
    return std::make_tuple(corner.pt.x, corner.pt.y, corner.response);
  };
  int mixed = 0;
  for (int i = 0; i < 40; ++i) {
    // Squares, of much contrast on one side and of little on the other; in the last images too few of much.
    cv::Mat image(200 + i, 260, CV_8UC1, cv::Scalar(100));
    for (int k = 0; k < 400; ++k) {
      const int x = static_cast<int>(noise.uniform(0.0, 255.0)), y = static_cast<int>(noise.uniform(0.0, 195.0));
      const double contrast = x < 200 - 5 * i ? noise.uniform(5.0, 90.0) : noise.uniform(3.0, 18.0);
      const int side = static_cast<int>(noise.uniform(4.0, 14.0));
      cv::rectangle(image, cv::Rect(x, y, side, side), cv::Scalar(100.0 + contrast), cv::FILLED);
    }
    const std::vector<cv::KeyPoint> direct = find_corners(image, kThreshold, kWanted, kThreshold);
    const std::vector<cv::KeyPoint> corners = find_corners(image, kThreshold, kWanted, kStrong);
    ASSERT_EQ(corners.size(), direct.size()) << i;
    for (std::size_t k = 0; k < corners.size(); ++k) EXPECT_EQ(key(corners[k]), key(direct[k])) << i << ' ' << k;
    const auto weak = std::count_if(corners.begin(), corners.end(),
                                    [](const cv::KeyPoint& corner) { return corner.response < kStrong; });
    mixed += weak > 5 && weak < 30 ? 1 : 0;
  }
  EXPECT_GT(mixed, 10) << "images whose weak corners are looked for beside strong ones";
  EXPECT_TRUE(find_corners(cv::Mat::zeros(100, 100, CV_8UC1), kThreshold, kWanted).empty());
  EXPECT_TRUE(find_corners(cv::Mat::zeros(100, 100, CV_8UC1), kThreshold, 0).empty());
}

TEST(FeatureMatcher, FindsWhatIsNearAndAlike) {
  Noise noise;
  ImageFeatures image;
  std::vector<SearchItem> items;
  for (int i = 0; i < 200; ++i) {
    ImageFeature feature;
    feature.pixel = Vec2(noise.uniform(10.0, 630.0), noise.uniform(10.0, 470.0));
    feature.level = i % 4;
    Descriptor descriptor{noise.bits(), noise.bits(), noise.bits(), noise.bits()};
    image.features.push_back(feature);
    image.descriptors.push_back(descriptor);
    SearchItem item;
    descriptor[0] ^= 0xff;
    item.descriptor = descriptor;
    item.pixel = feature.pixel + Vec2(4.0, -3.0);
    item.radius_px = i == 3 ? 2.0 : 6.0;
    item.level = i == 5 ? feature.level + 2 : feature.level;
    items.push_back(item);
  }
  image.index(kKinect);
  std::vector<bool> is_taken(image.size(), false);
  is_taken[8] = true;
  const std::vector<int> found = search(items, image, is_taken, kMatchBits, 0.9);
  for (int i = 0; i < 200; ++i) {
    const bool is_out_of_question = i == 3 || i == 5 || i == 8;
    EXPECT_EQ(found[static_cast<std::size_t>(i)], is_out_of_question ? -1 : i);
  }
}

}  // namespace
}  // namespace semantic_topo_loop::core
