#include "ros/annotated_image.h"

#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/core.hpp>
#include <random>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop {
namespace {

constexpr int kCup = 41, kWidth = 640, kHeight = 480;
constexpr double kFocal_px = 500.0, kRadius_m = 0.3, kDistance_m = 2.0;
constexpr double kDrawn_px = 2.0;  // half of a thick line, and rounding

core::Frame make_frame() {
  core::Frame frame;
  frame.camera = {kFocal_px, kFocal_px, 320.0, 240.0, kWidth, kHeight, {}};
  return frame;
}

MapView make_view(const core::Landmark& landmark) {
  core::MapUpdate update;
  update.changed = {landmark};
  MapView view;
  view.apply(update);
  return view;
}

core::Landmark make_sphere(std::int64_t id, const core::Vec3& center) {
  core::Landmark landmark;
  landmark.id = id;
  landmark.class_id = kCup;
  landmark.state = core::LandmarkState::kConfirmed;
  landmark.ellipsoid =
      core::Ellipsoid{core::SE3(core::Quaternion::Identity(), center), core::Vec3::Constant(kRadius_m)};
  return landmark;
}

core::AssociationFrame make_detection(std::int64_t landmark_id, const core::Box& box) {
  core::AssociationFrame frame;
  core::Association& association = frame.associations.emplace_back();
  association.landmark_id = landmark_id;
  association.class_id = association.landmark_class_id = kCup;
  association.box = box;
  return frame;
}

cv::Mat black() { return {kHeight, kWidth, CV_8UC3, cv::Scalar::all(0.0)}; }

bool is_drawn(const cv::Mat& image, double x, double y) {
  return cv::norm(image.at<cv::Vec3b>(static_cast<int>(std::lround(y)), static_cast<int>(std::lround(x)))) > 60.0;
}

TEST(Annotate, ASphereBeforeTheCameraIsItsCircle) {
  cv::Mat image = black();
  const MapView view = make_view(make_sphere(3, {0.0, 0.0, kDistance_m}));
  ASSERT_TRUE(annotate(make_frame(), {}, view, {}, &image));
  // The cone that touches a sphere: tan = R / sqrt(d^2 - R^2).
  const double radius_px = kFocal_px * kRadius_m / std::sqrt(kDistance_m * kDistance_m - kRadius_m * kRadius_m);
  for (int deg = 0; deg < 360; deg += 15) {
    const double a = core::radians(deg);
    EXPECT_TRUE(is_drawn(image, 320.0 + radius_px * std::cos(a), 240.0 + radius_px * std::sin(a))) << deg;
  }
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      if (!is_drawn(image, x, y)) continue;
      ASSERT_NEAR(std::hypot(x - 320.0, y - 240.0), radius_px, kDrawn_px);
    }
  }
}

TEST(Annotate, TheObjectMovesWithCameraAndCorrection) {
  core::MapUpdate update;
  update.changed = {make_sphere(3, {1.0, 0.0, kDistance_m})};
  update.T_map_odom.t = core::Vec3(0.6, 0.0, 0.0);
  MapView view;
  view.apply(update);
  core::Frame frame = make_frame();
  frame.T_odom_camera.t = core::Vec3(0.4, 0.0, 0.0);
  cv::Mat moved = black(), still = black();
  ASSERT_TRUE(annotate(frame, {}, view, {}, &moved));
  ASSERT_TRUE(annotate(make_frame(), {}, make_view(make_sphere(3, {0.0, 0.0, kDistance_m})), {}, &still));
  constexpr double kRounding = 10.0;  // of the same drawing
  EXPECT_LT(cv::norm(moved, still), kRounding) << "together they stand before it";
}

TEST(Annotate, DetectionsHaveTheirBoxAndTheirLandmarkStandsOut) {
  const core::Landmark landmark = make_sphere(3, {0.0, 0.0, kDistance_m});
  MapView view = make_view(landmark);
  core::MapUpdate merge;
  merge.merged = {{8, 3}};
  view.apply(merge);
  const core::Box box = {200.0, 150.0, 440.0, 350.0};
  cv::Mat alone = black(), seen = black(), unknown = black();
  ASSERT_TRUE(annotate(make_frame(), {}, view, {}, &alone));
  ASSERT_TRUE(annotate(make_frame(), make_detection(8, box), view, {}, &seen));
  ASSERT_TRUE(annotate(make_frame(), make_detection(-1, box), view, {}, &unknown));
  for (const cv::Mat& image : {seen, unknown}) {
    EXPECT_TRUE(is_drawn(image, 200.0, 250.0));
    EXPECT_TRUE(is_drawn(image, 440.0, 250.0));
    EXPECT_TRUE(is_drawn(image, 320.0, 150.0));
    EXPECT_TRUE(is_drawn(image, 320.0, 350.0));
  }
  const cv::Rect inside(210, 160, 220, 180);
  EXPECT_GT(cv::norm(seen(inside)), 1.1 * cv::norm(alone(inside))) << "by the survivor of the merged id";
  EXPECT_EQ(cv::norm(unknown(inside), alone(inside)), 0.0);
  const auto at = unknown.at<cv::Vec3b>(250, 200);
  EXPECT_TRUE(at[0] == at[1] && at[1] == at[2]) << "grey without a landmark";
  EXPECT_NE(cv::norm(seen - unknown), 0.0);
}

TEST(Annotate, RefusesAnImageOfAnotherSizeAndIsQuietAboutWhatIsBehind) {
  cv::Mat small(240, 320, CV_8UC3, cv::Scalar::all(0.0));
  const core::Status status = annotate(make_frame(), {}, {}, {}, &small);
  ASSERT_FALSE(status);
  EXPECT_EQ(status.message(), "colour image of 320 x 240, the calibration is for 640 x 480");
  for (const core::Vec3& center : {core::Vec3(0.0, 0.0, -2.0), core::Vec3(0.0, 0.0, 0.1), core::Vec3(50.0, 0.0, 2.0)}) {
    cv::Mat image = black();
    ASSERT_TRUE(annotate(make_frame(), {}, make_view(make_sphere(3, center)), {}, &image));
    EXPECT_EQ(cv::norm(image), 0.0) << center.transpose();
  }
  cv::Mat image = black();
  ASSERT_TRUE(annotate(make_frame(), make_detection(-1, {}), {}, {}, &image));
  EXPECT_EQ(cv::norm(image), 0.0) << "a box out of the lens's view";
}

TEST(Annotate, ADistortedImageIsStraightened) {
  core::Frame frame = make_frame();
  frame.camera.distortion = {-0.25, 0.08, 0.0, 0.0, 0.0};
  // A point of the world, where the lens puts it, must come to where the pinhole would.
  const core::Vec2 pinhole(560.0, 400.0);
  const core::Vec2 raw = frame.camera.distort(pinhole);
  ASSERT_GT((raw - pinhole).norm(), 5.0);
  cv::Mat image = black();
  const cv::Point at(static_cast<int>(std::lround(raw.x())), static_cast<int>(std::lround(raw.y())));
  image(cv::Rect(at.x - 1, at.y - 1, 3, 3)) = cv::Scalar::all(255.0);
  ASSERT_TRUE(annotate(frame, {}, {}, {}, &image));
  EXPECT_TRUE(is_drawn(image, pinhole.x(), pinhole.y()));
  EXPECT_FALSE(is_drawn(image, raw.x(), raw.y()));
}

TEST(EllipseOf, TouchesTheOutlineOfTheSurface) {
  std::mt19937_64 random(5);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  const core::Frame frame = make_frame();
  for (int i = 0; i < 20; ++i) {
    const core::Quaternion q = core::so3_exp(3.0 * core::Vec3(uniform(random), uniform(random), uniform(random)));
    const core::Vec3 center(uniform(random), uniform(random), 4.0);
    const core::Ellipsoid ellipsoid{core::SE3(q, center), {0.1, 0.25, 0.5}};
    const auto conic = core::project(ellipsoid.dual(), core::projection_matrix(frame.camera, core::SE3()));
    ASSERT_TRUE(conic);
    const std::optional<cv::RotatedRect> ellipse = ellipse_of(*conic);
    ASSERT_TRUE(ellipse);
    const double angle = core::radians(ellipse->angle);
    double outermost = 0.0;
    for (int k = 0; k < 20000; ++k) {
      const core::Vec3 on_sphere = core::Vec3(uniform(random), uniform(random), uniform(random)).normalized();
      const core::Vec2 pixel =
          frame.camera.pixel(ellipsoid.T_world_quadric * core::Vec3(ellipsoid.semi_axes.cwiseProduct(on_sphere)));
      const core::Vec2 d = pixel - core::Vec2(ellipse->center.x, ellipse->center.y);
      const double along = (std::cos(angle) * d.x() + std::sin(angle) * d.y()) / (0.5 * ellipse->size.width);
      const double across = (-std::sin(angle) * d.x() + std::cos(angle) * d.y()) / (0.5 * ellipse->size.height);
      outermost = std::max(outermost, std::hypot(along, across));
    }
    EXPECT_NEAR(outermost, 1.0, 1e-3);
  }
  EXPECT_FALSE(ellipse_of(core::Conic::Identity()));
}

}  // namespace
}  // namespace semantic_topo_loop
