#include "apps/program.h"

#include <gtest/gtest.h>

namespace semantic_topo_loop::apps {
namespace {

/// A command with one argument of each kind.
struct Values {
  std::string in, out, name = "none", color = "red";
  bool is_fast = false, has_images = true;
  double share = 0.5, angle = 0.0;
  int count = 3;
  std::uint64_t seed = 1;
  core::OptionTexts options;

  core::Status read(const std::vector<std::string>& words) {
    Command command("", "", "");
    command.word("IN", &in)
        .option("out", path(&out)->required(), "")
        .option("name", text(&name), "")
        .option("color", choice(&color, {"red", "green", "blue"}), "")
        .option("fast", flag(&is_fast), "")
        .option("images", boolean(&has_images), "")
        .option("share", number(&share, 0.0, 1.5), "")
        .option("angle", number(&angle), "")
        .option("count", integer(&count, 1, 10), "")
        .option("seed", integer(&seed, 0), "")
        .option("set", assignments(&options), "");
    return read_arguments(command, words);
  }
};

/// What is wrong with words that follow good ones.
std::string problem(std::vector<std::string> words) {
  words.insert(words.begin(), {"a", "--out", "b"});
  return Values().read(words).message();
}

TEST(CommandLine, WhatIsNotGivenKeepsItsValue) {
  Values values;
  ASSERT_EQ(values.read({"--out", "b", "a"}).message(), "");
  EXPECT_EQ(values.in, "a");
  EXPECT_EQ(values.out, "b");
  EXPECT_EQ(values.name, "none");
  EXPECT_EQ(values.color, "red");
  EXPECT_FALSE(values.is_fast);
  EXPECT_TRUE(values.has_images);
  EXPECT_EQ(values.share, 0.5);
  EXPECT_EQ(values.count, 3);
  EXPECT_TRUE(values.options.empty());
}

TEST(CommandLine, EveryKindIsRead) {
  Values values;
  const auto status = values.read({"--fast",  "-a",    "--out",    "b",       "--name",    "",
                                   "--color", "blue",  "--images", "false",   "--share",   "1.5",
                                   "--angle", "-1e-3", "--count",  "10",      "--seed",    "9007199254740993",
                                   "--set",   "a.b=1", "--set",    "a.c=x=y", "--set=a.b="});
  ASSERT_TRUE(status) << status.message();
  EXPECT_TRUE(values.is_fast);
  EXPECT_EQ(values.in, "-a");
  EXPECT_EQ(values.name, "");
  EXPECT_EQ(values.color, "blue");
  EXPECT_FALSE(values.has_images);
  EXPECT_EQ(values.share, 1.5);
  EXPECT_EQ(values.angle, -1e-3);
  EXPECT_EQ(values.count, 10);
  EXPECT_EQ(values.seed, 9007199254740993u) << "exact, as no double is";
  EXPECT_EQ(values.options, (core::OptionTexts{{"a.b", ""}, {"a.c", "x=y"}}));
}

TEST(CommandLine, WordsThatDoNotFitAreNamed) {
  EXPECT_EQ(problem({"--typo", "3"}), "unknown argument '--typo'");
  EXPECT_EQ(problem({"c"}), "unknown argument 'c'");
  EXPECT_EQ(problem({""}), "unknown argument ''");
  EXPECT_EQ(problem({"--nam", "x"}), "unknown argument '--nam'") << "names are not abbreviated";
  EXPECT_EQ(problem({"--name"}), "argument --name lacks its value");
  EXPECT_EQ(problem({"--name", "--fast"}), "argument --name lacks its value");
  EXPECT_EQ(problem({"--name", "--typo"}), "argument --name lacks its value");
  EXPECT_EQ(problem({"--fast=3"}), "argument --fast takes no value");
  EXPECT_EQ(problem({"--fast", "--fast"}), "argument --fast is given twice");
  EXPECT_EQ(problem({"--out", "c"}), "argument --out is given twice");
}

TEST(CommandLine, WhatIsMissingIsNamed) {
  EXPECT_EQ(Values().read({"--out", "b"}).message(), "argument IN is missing");
  EXPECT_EQ(Values().read({"a"}).message(), "argument --out is missing");
  EXPECT_EQ(Values().read({"a", "--out", ""}).message(), "argument --out '' must be a path");
}

TEST(CommandLine, ValuesThatDoNotFitAreNamed) {
  EXPECT_EQ(problem({"--color", "pink"}), "argument --color 'pink' must be red, green or blue");
  EXPECT_EQ(problem({"--images", "1"}), "argument --images '1' must be true or false");
  EXPECT_EQ(problem({"--share", "1.6"}), "argument --share '1.6' must be a number in [0, 1.5]");
  EXPECT_EQ(problem({"--share", "nan"}), "argument --share 'nan' must be a number in [0, 1.5]");
  EXPECT_EQ(problem({"--angle", "wide"}), "argument --angle 'wide' must be a number");
  EXPECT_EQ(problem({"--angle", "inf"}), "argument --angle 'inf' must be a number");
  EXPECT_EQ(problem({"--count", "0"}), "argument --count '0' must be an integer in [1, 10]");
  EXPECT_EQ(problem({"--count", "2.5"}), "argument --count '2.5' must be an integer in [1, 10]");
  EXPECT_EQ(problem({"--count", "4294967297"}), "argument --count '4294967297' must be an integer in [1, 10]");
  EXPECT_EQ(problem({"--seed", "-1"}), "argument --seed '-1' must be an integer >= 0");
  EXPECT_EQ(problem({"--set", "a.b"}), "argument --set 'a.b' must be <module>.<field>=<value>");
  EXPECT_EQ(problem({"--set", "=3"}), "argument --set '=3' must be <module>.<field>=<value>");
}

}  // namespace
}  // namespace semantic_topo_loop::apps
