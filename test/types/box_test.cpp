#include "semantic_topo_loop/types/box.h"

#include <gtest/gtest.h>

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

}  // namespace
}  // namespace semantic_topo_loop::core
