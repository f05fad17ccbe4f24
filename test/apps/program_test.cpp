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
    Command command;
    command.words = {{"IN", &in}};
    command.option("out", path(&out))
        .option("name", po::value(&name))
        .option("color", choice(&color, {"red", "green", "blue"}))
        .option("fast", po::bool_switch(&is_fast))
        .option("images", boolean(&has_images))
        .option("share", number(&share, 0.0, 1.5))
        .option("angle", number(&angle))
        .option("count", number(&count, 1, 10))
        .option("seed", number(&seed, 0))
        .option("set", assignments(&options));
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
  EXPECT_EQ(problem({"--typo", "3"}), "unrecognised option '--typo'");
  EXPECT_EQ(problem({"c"}), "unrecognised argument 'c'");
  EXPECT_EQ(problem({""}), "unrecognised argument ''");
  EXPECT_EQ(problem({"--nam", "x"}), "unrecognised option '--nam'") << "names are not abbreviated";
  EXPECT_EQ(problem({"--name"}), "the required argument for option '--name' is missing");
  EXPECT_EQ(problem({"--name", "--fast"}), "the required argument for option '--name' is missing");
  EXPECT_EQ(problem({"--name", "--typo"}), "the required argument for option '--name' is missing");
  EXPECT_EQ(problem({"--fast=3"}), "option '--fast' does not take any arguments");
  EXPECT_EQ(problem({"--fast", "--fast"}), "option '--fast' cannot be specified more than once");
  EXPECT_EQ(problem({"--out", "c"}), "option '--out' cannot be specified more than once");
}

TEST(CommandLine, WhatIsMissingIsNamed) {
  EXPECT_EQ(Values().read({"--out", "b"}).message(), "the option '--IN' is required but missing");
  EXPECT_EQ(Values().read({"a"}).message(), "the option '--out' is required but missing");
  EXPECT_EQ(Values().read({"a", "--out", ""}).message(), "the argument ('') for option '--out' must be a path");
}

TEST(CommandLine, ValuesThatDoNotFitAreNamed) {
  EXPECT_EQ(problem({"--color", "pink"}), "the argument ('pink') for option '--color' must be red, green or blue");
  EXPECT_EQ(problem({"--images", "1"}), "the argument ('1') for option '--images' must be true or false");
  EXPECT_EQ(problem({"--share", "1.6"}),
            "the argument ('1.6') for option '--share' must be a finite number in [0, 1.5]");
  EXPECT_EQ(problem({"--share", "nan"}),
            "the argument ('nan') for option '--share' must be a finite number in [0, 1.5]");
  EXPECT_EQ(problem({"--angle", "wide"}), "the argument ('wide') for option '--angle' is invalid");
  EXPECT_EQ(problem({"--angle", "inf"}), "the argument ('inf') for option '--angle' must be a finite number");
  EXPECT_EQ(problem({"--count", "0"}), "the argument ('0') for option '--count' must be an integer in [1, 10]");
  EXPECT_EQ(problem({"--count", "2.5"}), "the argument ('2.5') for option '--count' is invalid");
  EXPECT_EQ(problem({"--count", "4294967297"}),
            "the argument ('4294967297') for option '--count' must be an integer in [1, 10]");
  EXPECT_EQ(problem({"--seed", "-1"}), "the argument ('-1') for option '--seed' must be an integer >= 0");
  EXPECT_EQ(problem({"--set", "a.b"}), "the argument ('a.b') for option '--set' must be <module>.<field>=<value>");
  EXPECT_EQ(problem({"--set", "=3"}), "the argument ('=3') for option '--set' must be <module>.<field>=<value>");
}

}  // namespace
}  // namespace semantic_topo_loop::apps
