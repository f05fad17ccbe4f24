#include <gtest/gtest.h>

#include <algorithm>

#include "semantic_topo_loop/io/loop_table.h"
#include "support/program_test.h"
#include "tools/evaluation/run_files.h"

namespace semantic_topo_loop::core {
namespace {

class PerturbProgram : public ProgramTest {
 protected:
  PerturbProgram() : ProgramTest(STL_PROGRAM_DIR "/perturb") {
    directory_.write("boxes.json", R"([{"file_name": "1.500000.png", "detections": [
      {"category_id": 41, "detection_score": 0.5, "bbox": [10, 20, 30, 60]},
      {"category_id": 73, "detection_score": 0.25, "bbox": [100, 20, 130, 60]}]},
      {"file_name": "1.600000.png", "detections": []}])");
    directory_.write("yolo/1.500000.txt", "41 10 20 20 40 0.5\n73 100 20 30 40 0.25\n");
    directory_.write("yolo/1.600000.txt", "");
  }

  int detections(const std::string& arguments) {
    return run("detections " + arguments + " --classes " STL_CONFIG_DIR "/classes_coco.yaml");
  }
};

TEST_F(PerturbProgram, WritesTheKindThatItReads) {
  ASSERT_EQ(detections("@boxes.json @worse.json --seed 3 --jitter 0.03"), 0) << err_;
  EXPECT_EQ(out_, "2 images, 2 boxes: 0 dropped, 0 relabelled\n");
  EXPECT_NE(read_whole(directory_.path("worse.json")).find("\"file_name\": \"1.500000.png\""), std::string::npos);
  ASSERT_EQ(detections("@yolo @worse --seed 3 --relabel 1"), 0) << err_;
  EXPECT_EQ(out_, "2 images, 2 boxes: 0 dropped, 2 relabelled\n");
  EXPECT_EQ(read_whole(directory_.path("worse/1.500000.txt")),
            "73 10.0000 20.0000 20.0000 40.0000 0.500000\n41 100.0000 20.0000 30.0000 40.0000 0.250000\n");
  EXPECT_TRUE(std::filesystem::exists(directory_.path("worse/1.600000.txt")));
}

TEST_F(PerturbProgram, TheBytesArePinned) {
  // The random numbers are part of the format: published figures must stay reproducible.
  ASSERT_EQ(detections("@yolo @worse --seed 5 --drop 0.1 --relabel 0.5 --jitter 0.03"), 0) << err_;
  EXPECT_EQ(read_whole(directory_.path("worse/1.500000.txt")),
            "73 9.5197 18.7997 21.0453 40.3666 0.500000\n41 99.6488 21.3106 30.1603 39.5632 0.250000\n");
}

TEST_F(PerturbProgram, FalseLoopsAreASeededShareOfTheRightOnes) {
  std::string keyframes = "keyframe_id,frame_id,stamp,x,y,z,qx,qy,qz,qw\n", loops = loop_table_header();
  for (int k = 0; k < 60; ++k) {
    const std::string id = std::to_string(k), frame = std::to_string(10 * k);
    keyframes += id + "," + frame + "," + frame + ".0," + id + ",0,0,0,0,0,1\n";
  }
  for (int k = 0; k < 20; ++k) {
    LoopClosure loop;
    loop.query_frame = 10 * (k + 40);
    loop.match_frame = 10 * k;
    loop.accepted = k < 10;
    loops += loop_table_row(loop);
  }
  directory_.write("run/keyframes.csv", keyframes);
  directory_.write("run/loops.csv", loops);
  ASSERT_EQ(run("loops @run @false.csv --seed 3 --share 0.5 --cluster 5 --distance 2"), 0) << err_;
  EXPECT_EQ(out_, "10 accepted loops, 5 wrong ones written\n");
  const auto wrong = read_given_loops(directory_.path("false.csv"));
  ASSERT_TRUE(wrong) << wrong.message();
  ASSERT_EQ(wrong->size(), 5U);
  for (const LoopClosure& loop : *wrong) {
    EXPECT_TRUE(loop.accepted);
    EXPECT_NEAR(loop.covariance(0, 0), 0.03 * 0.03, 1e-7);
    // Without rotation in the odometry the error of all members is the same but for the lever arm of the rotation.
    const Vec3 odometry(0.1 * static_cast<double>(loop.query_frame - loop.match_frame), 0.0, 0.0);
    EXPECT_GT((loop.T_match_query.t - odometry).norm(), 0.5);
  }
  const std::string first = read_whole(directory_.path("false.csv"));
  ASSERT_EQ(run("loops @run @false.csv --seed 3 --share 0.5 --cluster 5 --distance 2"), 0) << err_;
  EXPECT_EQ(read_whole(directory_.path("false.csv")), first);
}

TEST_F(PerturbProgram, BadArgumentsAreOneClearError) {
  expect_failure("", 2, "the sub-command is missing");
  expect_failure("poses", 2, "unknown sub-command 'poses'");
  expect_failure("loops @run", 2, "argument OUT is missing");
  expect_failure("loops @run @out.csv --cluster 0", 2, "'cluster' = '0' must be >= 1");
  expect_failure("loops @run @out.csv", 1, "keyframes.csv");
  EXPECT_EQ(detections("@boxes.json"), 2);
  expect_one_line_error("argument OUT is missing");
  EXPECT_EQ(detections("@boxes.json @out.json --drop 1.5"), 2);
  expect_one_line_error("'drop' = '1.5' must be in [0, 1]");
  EXPECT_EQ(detections("@boxes.json @out.json --jitter much"), 2);
  expect_one_line_error("--jitter 'much' must be a number");
  EXPECT_EQ(detections("@boxes.json @out.json --seed -1"), 2);
  expect_one_line_error("--seed '-1' must be an integer >= 0");
  EXPECT_EQ(detections("@boxes.json @out.json --flip 0.1"), 2);
  expect_one_line_error("unknown argument '--flip'");
  expect_failure("detections @boxes.json @out.json --drop", 2, "argument --drop lacks its value");
  EXPECT_EQ(detections("@boxes.json @boxes.json"), 2);
  expect_one_line_error("is the input itself");
  EXPECT_FALSE(std::filesystem::exists(directory_.path("out.json")));
}

TEST_F(PerturbProgram, BadFilesAreOneClearError) {
  EXPECT_EQ(detections("@none.json @out.json"), 1);
  expect_one_line_error("none.json");
  EXPECT_EQ(detections("@boxes.json @none/out.json"), 1);
  expect_one_line_error("none/out.json");
}

TEST_F(PerturbProgram, Help) {
  EXPECT_EQ(run("--help"), 0);
  EXPECT_NE(out_.find("perturb detections IN OUT"), std::string::npos);
}

}  // namespace
}  // namespace semantic_topo_loop::core
