#include <gtest/gtest.h>

#include <filesystem>

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

class OfflineRun : public OfflineProgram {
 protected:
  OfflineRun() {
    directory_.write("t.txt", "1.0 0 0 0 0 0 0 1\n1.1 0.1 0 0 0 0 0 1\n");
    directory_.write("d.json", R"([{"file_name": "1.0.png", "detections": []}])");
    directory_.write("file", "");
    std::filesystem::create_symlink("loop", directory_.path("loop"));
  }
  static std::string with(const std::string& detections, const std::string& output) {
    return "--trajectory @t.txt --detections @" + detections +
           " --camera " STL_CONFIG_DIR "/camera/tum_fr2.yaml --classes " STL_CONFIG_DIR
           "/classes_coco.yaml --output @" +
           output;
  }
};

TEST_F(OfflineRun, OutputThatCannotBeWrittenIsOneClearErrorBeforeTheRun) {
  ASSERT_EQ(run(with("d.json", "run")), 0) << err_;
  expect_failure(with("d.json", "file/run"), 1, "file/run");
  expect_failure(with("d.json", "loop"), 1, "loop");
  expect_failure(with("d.json", std::string(300, 'x')), 1, "xxx");
  expect_failure(with("d.json", "run") + " --save-map @file/map.json", 1, "file/map.json");
  std::filesystem::create_directories(directory_.path("taken/.writable/in the way"));
  expect_failure(with("d.json", "taken"), 1, "taken");
}

TEST_F(OfflineRun, NumbersThatNothingHoldsAreOneClearError) {
  directory_.write("huge.json", R"([{"file_name": "1.0.png", "detections": [{"category_id": 41, "detection_score": )"
                                R"(1e999, "bbox": [1, 2, 30, 40]}]}])");
  EXPECT_EQ(run(with("huge.json", "run")), 1);
  expect_one_line_error("offline: error: ");
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
