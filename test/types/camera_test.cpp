#include "semantic_topo_loop/types/camera.h"

#include <gtest/gtest.h>

#include "semantic_topo_loop/geometry/quadric.h"
#include "semantic_topo_loop/io/yaml_files.h"
#include "support/random_poses.h"
#include "support/test_files.h"

namespace semantic_topo_loop::core {
namespace {

TEST(Box, Measures) {
  const Box box{10.0, 20.0, 40.0, 100.0};
  EXPECT_EQ(box.width(), 30.0);
  EXPECT_EQ(box.height(), 80.0);
  EXPECT_EQ(box.area(), 2400.0);
  EXPECT_EQ(box.center(), Vec2(25.0, 60.0));
  EXPECT_NEAR(box.size(), std::sqrt(2400.0), 1e-12);
}

TEST(Box, ValidOnlyWithAnArea) {
  EXPECT_TRUE((Box{0.0, 0.0, 1.0, 1.0}.is_valid()));
  EXPECT_FALSE((Box{1.0, 0.0, 1.0, 1.0}.is_valid()));
  EXPECT_FALSE((Box{0.0, 2.0, 1.0, 1.0}.is_valid()));
  EXPECT_FALSE((Box{0.0, 0.0, std::nan(""), 1.0}.is_valid()));
  EXPECT_FALSE((Box{0.0, 0.0, HUGE_VAL, 1.0}.is_valid()));
  EXPECT_EQ((Box{5.0, 5.0, 1.0, 1.0}.area()), 0.0);
}

TEST(Box, IntersectionOverUnion) {
  const Box a{0.0, 0.0, 10.0, 10.0};
  EXPECT_EQ(iou(a, a), 1.0);
  EXPECT_NEAR(iou(a, {5.0, 0.0, 15.0, 10.0}), 1.0 / 3.0, 1e-15);
  EXPECT_NEAR(iou(a, {2.0, 2.0, 4.0, 4.0}), 0.04, 1e-15);
  EXPECT_EQ(iou(a, {10.0, 0.0, 20.0, 10.0}), 0.0);  // they only touch
  EXPECT_EQ(iou(a, {50.0, 50.0, 60.0, 60.0}), 0.0);
  EXPECT_EQ(iou(Box{1.0, 1.0, 1.0, 1.0}, Box{1.0, 1.0, 1.0, 1.0}), 0.0);
}

TEST(Box, ClipsToTheImage) {
  const Box box = clip({-20.0, 10.0, 700.0, 500.0}, 640.0, 480.0);
  EXPECT_EQ(box.edges(), Vec4(0.0, 10.0, 640.0, 480.0));
  EXPECT_EQ(clip({-20.0, -20.0, -10.0, -10.0}, 640.0, 480.0).area(), 0.0);
}

TEST(Box, NamesTheCutSides) {
  EXPECT_EQ(truncated_sides({100.0, 100.0, 200.0, 200.0}, 640.0, 480.0, 8.0), 0);
  EXPECT_EQ(truncated_sides({8.0, 100.0, 200.0, 200.0}, 640.0, 480.0, 8.0), kLeft);
  EXPECT_EQ(truncated_sides({100.0, 3.0, 633.0, 200.0}, 640.0, 480.0, 8.0), kTop | kRight);
  EXPECT_EQ(truncated_sides({0.0, 0.0, 640.0, 480.0}, 640.0, 480.0, 0.0), kLeft | kTop | kRight | kBottom);
}

TEST(Camera, SeesBeyondTheRawImagesRectangleThroughAWideLens) {
  Camera wide{458.654, 457.296, 367.215, 240.0, 752, 480, {-0.28340811, 0.07395907, 0.0, 0.0, 0.0}};
  const Box image = wide.image();
  EXPECT_NEAR(wide.distort(Vec2(image.x1, 240.0)).x(), 0.0, 1e-9);
  EXPECT_NEAR(wide.distort(Vec2(image.x2, 240.0)).x(), 752.0, 1e-9);
  EXPECT_LT(image.x1, -90.0);
  EXPECT_GT(image.x2, 860.0);
  EXPECT_LT(image.y1, -20.0);
  EXPECT_GT(image.y2, 499.0);
  wide.distortion = {-2.0, 0.0, 0.0, 0.0, 0.0};
  EXPECT_EQ(wide.image().x1, 0.0) << "where no ray comes from";
  wide.distortion = {};
  EXPECT_EQ(wide.image().edges(), Vec4(0.0, 0.0, 752.0, 480.0));
}

Camera tum_camera(const std::string& name) {
  return checked(read_camera(std::string(STL_CONFIG_DIR) + "/camera/tum_" + name + ".yaml"));
}

class TumCamera : public ::testing::TestWithParam<const char*> {};

TEST_P(TumCamera, UndistortThenDistortGivesThePixelBack) {
  const Camera camera = tum_camera(GetParam());
  for (int u = 0; u <= camera.width; u += 20) {
    for (int v = 0; v <= camera.height; v += 20) {
      const Vec2 raw(u, v);
      EXPECT_NEAR((camera.distort(camera.undistort(raw)) - raw).norm(), 0.0, 1e-6) << raw.transpose();
    }
  }
}

TEST_P(TumCamera, KeepsThePrincipalPoint) {
  const Camera camera = tum_camera(GetParam());
  const Vec2 center(camera.cx, camera.cy);
  EXPECT_NEAR((camera.undistort(center) - center).norm(), 0.0, 1e-9);
}

INSTANTIATE_TEST_SUITE_P(All, TumCamera, ::testing::Values("fr1", "fr2", "fr3"));

TEST(Camera, DistortsByThePlumbBobFormula) {
  Camera camera{500.0, 400.0, 320.0, 240.0, 640, 480, {0.1, -0.2, 0.01, -0.02, 0.3}};
  const double x = 0.2, y = -0.1, r2 = x * x + y * y;
  const double radial = 1.0 + 0.1 * r2 - 0.2 * r2 * r2 + 0.3 * r2 * r2 * r2;
  const double xd = x * radial + 2.0 * 0.01 * x * y - 0.02 * (r2 + 2.0 * x * x);
  const double yd = y * radial + 0.01 * (r2 + 2.0 * y * y) + 2.0 * -0.02 * x * y;
  const Vec2 expected(500.0 * xd + 320.0, 400.0 * yd + 240.0);
  EXPECT_NEAR((camera.distort({500.0 * x + 320.0, 400.0 * y + 240.0}) - expected).norm(), 0.0, 1e-10);
}

TEST(Camera, TakesOverFocalLengthsOfTheSameCameraOnly) {
  const Camera stated = tum_camera("fr1");
  Camera corrected = stated;
  corrected.fx *= 0.95;
  corrected.fy *= 0.95;
  EXPECT_EQ(stated.with_focal_lengths_of(corrected).fx, corrected.fx);
  EXPECT_EQ(stated.with_focal_lengths_of(corrected).fy, corrected.fy);
  Camera stretched = corrected, moved = corrected, of_another_lens = corrected, larger = corrected;
  stretched.fy *= 1.001;
  moved.cx += 1.0;
  of_another_lens.distortion[0] += 0.01;
  larger.width *= 2;
  for (const Camera& other : {stretched, moved, of_another_lens, larger, tum_camera("fr2"), Camera()}) {
    EXPECT_EQ(stated.with_focal_lengths_of(other).fx, stated.fx);
  }
}

TEST(Camera, WithoutDistortionPixelsStay) {
  const Camera camera = tum_camera("fr3");
  EXPECT_FALSE(camera.has_distortion());
  EXPECT_EQ(camera.undistort(Vec2(12.0, 470.0)), Vec2(12.0, 470.0));
  EXPECT_EQ(camera.undistort(Box{1.0, 2.0, 3.0, 4.0}).edges(), Vec4(1.0, 2.0, 3.0, 4.0));
}

TEST(Camera, UndistortsABoxByTheMiddlesOfItsSides) {
  const Camera camera = tum_camera("fr2");
  const Box raw{40.0, 60.0, 200.0, 140.0};
  const Box box = camera.undistort(raw);
  EXPECT_EQ(box.x1, camera.undistort(Vec2(40.0, 100.0)).x());
  EXPECT_EQ(box.x2, camera.undistort(Vec2(200.0, 100.0)).x());
  EXPECT_EQ(box.y1, camera.undistort(Vec2(120.0, 60.0)).y());
  EXPECT_EQ(box.y2, camera.undistort(Vec2(120.0, 140.0)).y());
}

TEST(Camera, ProjectsPointsOfTheWorld) {
  RandomPoses random(5);
  const Camera camera = tum_camera("fr3");
  for (int i = 0; i < 50; ++i) {
    const SE3 T_world_camera = random.pose(3.0);
    const Vec3 point_camera(random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0), random.uniform(0.5, 4.0));
    const Vec3 image = projection_matrix(camera, T_world_camera) * (T_world_camera * point_camera).homogeneous();
    const Vec2 pixel = image.hnormalized();
    EXPECT_NEAR((camera.ray(pixel) * point_camera.z() - point_camera).norm(), 0.0, 1e-9);
  }
}

TEST(Camera, NamesTheBadField) {
  const Camera good = tum_camera("fr1");
  EXPECT_TRUE(good.check()) << good.check().message();
  Camera bad = good;
  bad.fy = -3.0;
  EXPECT_EQ(bad.check().message(), "fy = -3 must be > 0");
  bad = good;
  bad.width = 0;
  EXPECT_NE(bad.check().message().find("width"), std::string::npos);
  bad = good;
  bad.width = bad.height = 1'000'000;
  EXPECT_EQ(bad.check().message(), "width = 1000000 must be in (0, 10000]") << "before anything allocates";
  bad.width = 640;
  EXPECT_EQ(bad.check().message(), "height = 1000000 must be in (0, 10000]");
  bad = good;
  bad.distortion[3] = std::nan("");
  EXPECT_NE(bad.check().message().find("distortion"), std::string::npos);
}

}  // namespace
}  // namespace semantic_topo_loop::core
