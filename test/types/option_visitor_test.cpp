#include "semantic_topo_loop/types/option_visitor.h"

#include <gtest/gtest.h>

namespace semantic_topo_loop::core {
namespace {

struct Settings {
  int least = 3;
  int most = 15;
  double score = 0.25;
  bool enabled = true;
  std::string mode = "graph";

  void visit(OptionVisitor& visitor) {
    visitor.module("test");
    visitor.live("least", least, at_least(1), "of them");
    visitor.live("most", most, any(), "of them");
    visitor.live("score", score, share(), "of one");
    visitor.live("enabled", enabled, "look");
    visitor("mode", mode, one_of({"graph", "paper"}), "how");
    visitor.require("least", least <= most, "<= test.most");
  }
};

TEST(LiveOptions, RowsTellTypeBoundsAndEveryDigit) {
  Settings settings;
  settings.score = 0.1 + 0.2;
  const std::vector<OptionRow> rows = list_options(settings);
  ASSERT_EQ(rows.size(), 5U);
  for (const OptionRow& row : rows) EXPECT_EQ(row.is_live, row.key != "test.mode") << row.key;
  EXPECT_EQ(rows[0].exact, OptionValue(3));
  EXPECT_EQ(rows[0].range.low(), 1.0);
  EXPECT_EQ(rows[0].range.high(), std::numeric_limits<double>::infinity());
  EXPECT_EQ(rows[2].exact, OptionValue(0.1 + 0.2));
  EXPECT_EQ(rows[2].range.high(), 1.0);
  EXPECT_EQ(rows[3].exact, OptionValue(true));
  EXPECT_EQ(rows[4].exact, OptionValue(std::string("graph")));
}

TEST(ChangeOptions, SetsWhatTextsAreGivenForAndKeepsTheRest) {
  Settings settings;
  settings.mode = "paper";
  EXPECT_TRUE(change_options({{"test.least", "20"}, {"test.most", "30"}, {"test.enabled", "false"}}, &settings))
      << "rules between fields hold for what they become";
  EXPECT_EQ(settings.least, 20);
  EXPECT_EQ(settings.most, 30);
  EXPECT_FALSE(settings.enabled);
  EXPECT_EQ(settings.score, 0.25);
  EXPECT_EQ(settings.mode, "paper");
}

TEST(ChangeOptions, OneThatIsRefusedChangesNothing) {
  Settings settings;
  const auto error_of = [&settings](const std::string& key, const std::string& value) {
    return change_options({{key, value}, {"test.most", "10"}}, &settings).message();
  };
  EXPECT_EQ(error_of("test.mode", "graph"), "parameter 'test.mode' = 'graph' cannot change while running");
  EXPECT_EQ(error_of("test.size", "1"), "unknown parameter 'test.size' = '1'");
  EXPECT_EQ(error_of("test.score", "1.5"), "parameter 'test.score' = '1.5' must be in [0, 1]");
  EXPECT_EQ(error_of("test.score", "nan"), "parameter 'test.score' = 'nan' is not a finite number");
  EXPECT_EQ(error_of("test.least", "11"), "parameter 'test.least' = '11' must be <= test.most");
  EXPECT_EQ(settings.most, 15);
  EXPECT_EQ(settings.least, 3);
}

}  // namespace
}  // namespace semantic_topo_loop::core
