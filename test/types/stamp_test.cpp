#include "semantic_topo_loop/types/stamp.h"

#include <gtest/gtest.h>

#include <random>

namespace semantic_topo_loop::core {
namespace {

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

}  // namespace
}  // namespace semantic_topo_loop::core
