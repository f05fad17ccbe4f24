#include <gtest/gtest.h>

#include "support/program_test.h"

namespace semantic_topo_loop::core {
namespace {

class OfflineProgram : public ProgramTest {
 protected:
  OfflineProgram() : ProgramTest(STL_PROGRAM_DIR "/offline") {}

  void expect_bad_arguments(const std::string& arguments, const std::string& part) {
    EXPECT_EQ(run("--camera @camera.yaml --output @run --classes " STL_CONFIG_DIR "/classes_coco.yaml " + arguments),
              2);
    expect_one_line_error("offline: error: " + part + " (see --help)");
  }
};

TEST_F(OfflineProgram, HelpAndParametersAreNoErrors) {
  EXPECT_EQ(run("--trajectory --help"), 0);
  EXPECT_EQ(out_.find("usage: offline --trajectory FILE"), 0u);
  EXPECT_NE(out_.find("Exit status: 0 done"), std::string::npos);
  EXPECT_EQ(run("--list-parameters"), 0);
  EXPECT_NE(out_.find("| `loop.mode` | graph |"), std::string::npos);
  expect_failure("--list-parameters loop", 2, "unrecognised argument 'loop'");
}

TEST_F(OfflineProgram, ArgumentsThatDoNotFitAreOneClearError) {
  expect_failure("", 2, "the option '--camera' is required but missing");
  const std::string no_source = "one of the arguments --trajectory, --rgbd and --bag is needed";
  expect_bad_arguments("", no_source);
  expect_bad_arguments("--rgbd @ --bag @b.bag", no_source);
  expect_bad_arguments("--trajectory @t.txt", "argument --detections is missing");
  expect_bad_arguments("--bag @b.bag --associations @a.txt", "argument --associations needs --rgbd");
  expect_bad_arguments("--bag @b.bag --points a.ply", "argument --points needs --rgbd");
  expect_bad_arguments("--rgbd @ --points a.obj",
                       "the argument ('a.obj') for option '--points' must be a path that ends in .ply or .pcd");
}

TEST_F(OfflineProgram, FilesThatAreMissingAreOneClearError) {
  expect_failure("--rgbd @ --camera @none.yaml --output @run --classes " STL_CONFIG_DIR "/classes_coco.yaml", 1,
                 "none.yaml: cannot open the file");
  EXPECT_EQ(err_.find("--help"), std::string::npos);
}

class OptimiseGraphProgram : public ProgramTest {
 protected:
  OptimiseGraphProgram() : ProgramTest(STL_PROGRAM_DIR "/optimise_graph") {}
};

TEST_F(OptimiseGraphProgram, ArgumentsThatDoNotFitAreOneClearError) {
  expect_failure("--robust gnc", 2, "the option '--IN.g2o' is required but missing");
  expect_failure("@in.g2o @out.g2o @more.g2o", 2, "unrecognised argument");
  expect_failure("@in.g2o @out.g2o --robust always", 2, "'always'");
  expect_failure("@in.g2o @out.g2o", 1, "in.g2o: cannot open the file");
}

}  // namespace
}  // namespace semantic_topo_loop::core
