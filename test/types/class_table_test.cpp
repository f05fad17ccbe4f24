#include "semantic_topo_loop/types/class_table.h"

#include <gtest/gtest.h>

namespace semantic_topo_loop::core {
namespace {

ClassTable small_table() {
  return *ClassTable::create({{0, "person", ClassRole::kDynamic, "", 1.7},
                              {41, "cup", ClassRole::kMovable, "vessel", 0.1},
                              {62, "tv", ClassRole::kStatic, "", 0.5},
                              {75, "vase", ClassRole::kMovable, "vessel", 0.2},
                              {27, "tie", ClassRole::kIgnore, "", 0.4},
                              {58, "plant", ClassRole::kStatic, "", 0.6}},
                             nullptr);
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
  std::string error;
  EXPECT_FALSE(
      ClassTable::create({{3, "a", ClassRole::kStatic, "", 1.0}, {3, "b", ClassRole::kStatic, "", 1.0}}, &error));
  EXPECT_EQ(error, "class id 3 is listed twice");
}

}  // namespace
}  // namespace semantic_topo_loop::core
