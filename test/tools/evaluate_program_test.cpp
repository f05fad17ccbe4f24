#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "support/program_test.h"

namespace semantic_topo_loop::core {
namespace {

class EvaluateProgram : public ProgramTest {
 protected:
  EvaluateProgram() : ProgramTest(STL_PROGRAM_DIR "/evaluate") {
    std::string poses;
    for (int i = 0; i < 10; ++i) {
      poses += std::to_string(100 + i) + ".000000 " + std::to_string(i) + " " + std::to_string(i * i) + " 0 0 0 0 1\n";
    }
    directory_.write("run/trajectory.txt", poses);
    directory_.write("gt.txt", poses);
    directory_.write("run/objects.csv",
                     "id,class_id,label,x,y,z,a,b,c,state,observations\n7,41,cup,1,2,3,0.1,0.2,0.3,confirmed,12\n"
                     "8,73,book,4,2,3,0.1,0.2,0.3,confirmed,12\n");
    directory_.write("reference.csv",
                     "id,label_id,label,x,y,z,a,b,c,certainty\n0,41,cup,1,2,3,0.1,0.1,0.1,certain\n"
                     "1,41,cup,8,2,3,0.1,0.1,0.1,certain\n");
    directory_.write(
        "run/loops.csv",
        "query_frame,match_frame,query_stamp,match_stamp,query_begin,query_end,match_begin,match_end,"
        "accepted,reason,score,x,y,z,qx,qy,qz,qw\n9,0,109.000000,100.000000,9,9,0,0,1,accepted,7.5,9,81,0,0,0,0,1\n");
    directory_.write("run/keyframes.csv",
                     "keyframe_id,frame_id,stamp,x,y,z,qx,qy,qz,qw\n0,0,100.000000,0,0,0,0,0,0,1\n");
    directory_.write("run/associations.csv", "frame_id,detection_index,landmark_id,level\n0,0,7,new\n9,0,7,joint\n");
  }

  nlohmann::json json() const { return nlohmann::json::parse(read_whole(directory_.path("out.json"))); }
};

TEST_F(EvaluateProgram, Help) {
  EXPECT_EQ(run("--help"), 0);
  EXPECT_NE(out_.find("evaluate trajectory EST GT"), std::string::npos);
  EXPECT_EQ(run("objects --help"), 0);
}

TEST_F(EvaluateProgram, Trajectory) {
  ASSERT_EQ(run("trajectory @run/trajectory.txt @gt.txt --json @out.json"), 0) << err_;
  EXPECT_NE(out_.find("ATE"), std::string::npos);
  EXPECT_EQ(json()["pairs"], 10);
  EXPECT_NEAR(json()["ate_m"]["rmse"].get<double>(), 0.0, 1e-9);
}

TEST_F(EvaluateProgram, Objects) {
  ASSERT_EQ(run("objects @run @gt.txt @reference.csv --json @out.json"), 0) << err_;
  EXPECT_NE(out_.find("certain: precision                 0.5000  (1 / 2)"), std::string::npos) << out_;
  EXPECT_EQ(json()["certain"]["recall"]["right"], 1);
  EXPECT_EQ(json()["certain"]["recall"]["total"], 2);
  EXPECT_EQ(json()["matches"].size(), 3u);
}

TEST_F(EvaluateProgram, Loops) {
  ASSERT_EQ(run("loops @run @gt.txt --mocap @gt.txt --json @out.json"), 0) << err_;
  EXPECT_EQ(json()["right_wide"]["right"], 1);
  EXPECT_EQ(json()["right_wide"]["total"], 1);
  EXPECT_EQ(json()["not_judged"], 0);
  EXPECT_EQ(json()["table"].size(), 3u);
  EXPECT_EQ(json()["table"][0]["keyframes"], 1);
  EXPECT_EQ(json()["by_viewpoint"].size(), 6u);
  EXPECT_TRUE(json()["revisits"].empty());
}

TEST_F(EvaluateProgram, LoopsOfARunThatGoesOnWithAMap) {
  EXPECT_EQ(run("loops @run @gt.txt"), 0) << err_;
  EXPECT_EQ(out_.find("earlier sessions"), std::string::npos) << out_;
  const auto shift = [this](const std::string& name, const std::string& from, const std::string& to) {
    std::string text = read_whole(directory_.path("run/" + name));
    text.replace(text.find(from), from.size(), to);
    directory_.write("run/" + name, text);
  };
  shift("keyframes.csv", "\n0,0,100", "\n4,50,100");
  shift("associations.csv", "\n0,0,7,new\n9,0", "\n50,0,7,new\n59,0");
  shift("loops.csv", "\n9,0,109.000000,100.000000,9,9,0,0", "\n59,20,109.000000,70.000000,59,59,18,20");
  ASSERT_EQ(run("loops @run @gt.txt --json @out.json"), 0) << err_;
  EXPECT_EQ(json()["into_earlier_sessions"], 1);
  EXPECT_EQ(json()["accepted"], 0);
  EXPECT_NE(out_.find("left out, into earlier sessions"), std::string::npos) << out_;
}

TEST_F(EvaluateProgram, DetailsOfLoops) {
  ASSERT_EQ(run("loops @run @gt.txt --sightings @run --details @details"), 0) << err_;
  EXPECT_NE(read_whole(directory_.path("details/judged_loops.csv")).find("\n9,0,1,accepted,7.500000,1,0.000000"),
            std::string::npos);
  EXPECT_FALSE(read_whole(directory_.path("details/reference_pairs.csv")).empty());
  EXPECT_NE(read_whole(directory_.path("details/precision_recall.csv")).find("\n7.500000,0,0,0,1,1,0,0\n"),
            std::string::npos);
}

TEST_F(EvaluateProgram, BadFilesEndWithOneErrorAndStatusOne) {
  expect_failure("trajectory @none.txt @gt.txt", 1, "none.txt: cannot open the file");
  expect_failure("objects @run @gt.txt @gt.txt", 1, "gt.txt");
  expect_failure("loops @nowhere @gt.txt", 1, "nowhere/loops.csv: cannot open the file");
  expect_failure("loops @run @gt.txt --sightings @nowhere", 1, "nowhere/objects.csv: cannot open the file");
  directory_.write("bad.txt", "1 2 3\n");
  expect_failure("loops @run @gt.txt --mocap @bad.txt", 1, "bad.txt:1: 3 columns instead of 8");
  directory_.write("other.txt", "1 0 0 0 0 0 0 1\n");
  expect_failure("trajectory @other.txt @gt.txt", 1, "other.txt: cannot align the trajectories");
  EXPECT_EQ(run("trajectory @gt.txt @gt.txt --json @none/out.json"), 1);
  EXPECT_NE(err_.find("none/out.json"), std::string::npos);
}

TEST_F(EvaluateProgram, BadArgumentsEndWithStatusTwo) {
  expect_failure("", 2, "the sub-command is missing");
  expect_failure("everything @run", 2, "unknown sub-command 'everything'");
  expect_failure("trajectory @gt.txt", 2, "evaluate trajectory: error: the option '--GT' is required but missing");
  expect_failure("trajectory @gt.txt @gt.txt --typo", 2, "unrecognised option '--typo'");
  expect_failure("objects @run @gt.txt @reference.csv --mocap @gt.txt", 2, "unrecognised option '--mocap'");
  expect_failure("trajectory @gt.txt @gt.txt --json", 2, "the required argument for option '--json' is missing");
}

}  // namespace
}  // namespace semantic_topo_loop::core
