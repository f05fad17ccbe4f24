#include <gtest/gtest.h>

#include <random>

#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop::core {
namespace {

ClassTable small_table() {
  return *ClassTable::create({{0, "person", ClassRole::kDynamic, "", 1.7},
                              {41, "cup", ClassRole::kMovable, "vessel", 0.1},
                              {62, "tv", ClassRole::kStatic, "", 0.5},
                              {75, "vase", ClassRole::kMovable, "vessel", 0.2},
                              {27, "tie", ClassRole::kIgnore, "", 0.4},
                              {58, "plant", ClassRole::kStatic, "", 0.6}});
}

TEST(ClassTable, FindsByIdAndName) {
  const ClassTable table = small_table();
  ASSERT_NE(table.find(62), nullptr);
  EXPECT_EQ(table.find(62)->name, "tv");
  ASSERT_NE(table.find("vase"), nullptr);
  EXPECT_EQ(table.find("vase")->id, 75);
  EXPECT_EQ(table.find(1), nullptr);
  EXPECT_EQ(table.find("sofa"), nullptr);
  EXPECT_EQ(table.name(41), "cup");
  EXPECT_EQ(table.name(99), "class_99");
}

TEST(ClassTable, ConfusableWithinAGroupOnly) {
  const ClassTable table = small_table();
  EXPECT_TRUE(table.confusable(41, 75));
  EXPECT_TRUE(table.confusable(62, 62));
  EXPECT_TRUE(table.confusable(99, 99));
  EXPECT_FALSE(table.confusable(41, 62));
  EXPECT_FALSE(table.confusable(62, 58));  // two empty groups are not one group
  EXPECT_FALSE(table.confusable(41, 99));
}

TEST(ClassTable, OnlyStaticAndMovableClassesAreMapped) {
  const ClassTable table = small_table();
  EXPECT_TRUE(table.is_mappable(62));
  EXPECT_TRUE(table.is_mappable(41));
  EXPECT_FALSE(table.is_mappable(0));
  EXPECT_FALSE(table.is_mappable(27));
  EXPECT_FALSE(table.is_mappable(99));
}

TEST(ClassTable, RefusesAnIdTwice) {
  const auto table = ClassTable::create({{3, "a", ClassRole::kStatic, "", 1.0}, {3, "b", ClassRole::kStatic, "", 1.0}});
  ASSERT_FALSE(table);
  EXPECT_EQ(table.message(), "class id 3 is listed twice");
  ObjectClass a, b;
  a.id = 3;
  b.id = 4;
  a.coco_id = b.coco_id = 5;
  EXPECT_EQ(ClassTable::create({a, b}).message(), "coco_id 5 is listed twice");
}

TEST(Stamp, ReadsDecimalTextExactly) {
  EXPECT_EQ(parse_stamp("1311868164.363181"), 1311868164363181000);
  EXPECT_EQ(parse_stamp("1311868163.8697"), 1311868163869700000);
  EXPECT_EQ(parse_stamp("1700000000.123456789"), 1700000000123456789);
  EXPECT_EQ(parse_stamp("7"), 7000000000);
  EXPECT_EQ(parse_stamp("7."), 7000000000);
  EXPECT_EQ(parse_stamp(".5"), 500000000);
  EXPECT_EQ(parse_stamp("0"), 0);
  EXPECT_EQ(parse_stamp("0000000000000000000000001.5"), 1500000000);
}

TEST(Stamp, ReadsExponents) {
  EXPECT_EQ(parse_stamp("1.311868164363181e+09"), 1311868164363181000);
  EXPECT_EQ(parse_stamp("1.311868164363181000e9"), 1311868164363181000);
  EXPECT_EQ(parse_stamp("15E-1"), 1500000000);
  EXPECT_EQ(parse_stamp("5e-20"), 0);
}

TEST(Stamp, RoundsBelowTheNanosecond) {
  EXPECT_EQ(parse_stamp("1.0000000004"), 1000000000);
  EXPECT_EQ(parse_stamp("1.0000000005"), 1000000001);
  EXPECT_EQ(parse_stamp("0.9999999999"), 1000000000);
}

TEST(Stamp, RefusesWhatIsNoStamp) {
  for (const char* text : {"", ".", "-1.0", "+1", "1.2.3", "1,5", "nan", "inf", "1e", "1e+", "1e99999", "0x10", " 1",
                           "1 ", "12s", "9223372037", "9223372036.854775808"}) {
    EXPECT_FALSE(parse_stamp(text)) << text;
  }
  EXPECT_EQ(parse_stamp("9223372036.854775807"), 9223372036854775807);
}

TEST(Stamp, WritesSixDecimalsOrNine) {
  EXPECT_EQ(format_stamp(1311868164363181000), "1311868164.363181");
  EXPECT_EQ(format_stamp(1500000000000000000), "1500000000.000000");
  EXPECT_EQ(format_stamp(1500000000000000001), "1500000000.000000001");
  EXPECT_EQ(format_stamp(5000), "0.000005");
}

TEST(Stamp, ComesBackFromText) {
  std::mt19937_64 random(3);
  for (int i = 0; i < 1000; ++i) {
    const auto stamp = static_cast<std::int64_t>(random() >> 1);
    EXPECT_EQ(parse_stamp(format_stamp(stamp)), stamp);
    EXPECT_EQ(parse_stamp(format_stamp(stamp / 1000 * 1000)), stamp / 1000 * 1000);
  }
}

StampedPoses poses_at(const std::vector<std::int64_t>& stamps) {
  StampedPoses poses;
  for (const std::int64_t stamp : stamps) poses.push_back({stamp, SE3()});
  return poses;
}

TEST(FindStamp, TakesTheNearestWithinTheTolerance) {
  const StampedPoses poses = poses_at({100, 200, 300});
  EXPECT_EQ(find_stamp(poses, 200, 0), &poses[1]);
  EXPECT_EQ(find_stamp(poses, 240, 50), &poses[1]);
  EXPECT_EQ(find_stamp(poses, 260, 50), &poses[2]);
  EXPECT_EQ(find_stamp(poses, 250, 50), &poses[1]);  // the earlier of two equally near ones
  EXPECT_EQ(find_stamp(poses, 90, 10), &poses[0]);
  EXPECT_EQ(find_stamp(poses, 310, 10), &poses[2]);
}

TEST(FindStamp, NullBeyondTheTolerance) {
  const StampedPoses poses = poses_at({100, 200, 300});
  EXPECT_EQ(find_stamp(poses, 250, 49), nullptr);
  EXPECT_EQ(find_stamp(poses, 89, 10), nullptr);
  EXPECT_EQ(find_stamp(poses, 311, 10), nullptr);
  EXPECT_EQ(find_stamp(StampedPoses(), 0, 1000), nullptr);
}

}  // namespace
}  // namespace semantic_topo_loop::core
