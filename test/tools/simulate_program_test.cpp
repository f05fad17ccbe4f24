#include <gtest/gtest.h>

#include <filesystem>

#include "support/program_test.h"

namespace semantic_topo_loop::core {
namespace {

/// Runs `simulate` and `simulate_bag` with a small camera.
class SimulateProgram : public ::testing::Test {
 protected:
  SimulateProgram() {
    directory_.write("camera.yaml",
                     "fx: 80\nfy: 80\ncx: 48\ncy: 36\nwidth: 96\nheight: 72\ndistortion: [0, 0, 0, 0, 0]\n");
  }

  ProgramRun run(const std::string& program, const std::string& arguments) {
    return run_program(program,
                       "--output @made --camera @camera.yaml --classes " STL_CONFIG_DIR
                       "/classes_coco.yaml --duration 0.4 --rate 10 " +
                           arguments,
                       directory_);
  }
  bool exists(const std::string& name) const { return std::filesystem::exists(directory_.path("made/" + name)); }

  TestDirectory directory_;
};

TEST_F(SimulateProgram, images_only_where_asked_for) {
  EXPECT_EQ(run(STL_PROGRAM_DIR "/simulate", "").status, 0);
  EXPECT_TRUE(exists("detections.json"));
  EXPECT_FALSE(exists("rgb"));
  EXPECT_FALSE(exists("manifest.txt"));
  EXPECT_EQ(run(STL_PROGRAM_DIR "/simulate", "--images true").status, 0);
  EXPECT_TRUE(exists("rgb/1400000000.300000.png"));
  EXPECT_TRUE(exists("depth/1400000000.308000.png"));
  EXPECT_FALSE(exists("sequence.bag"));
}

TEST_F(SimulateProgram, simulate_bag_writes_folder_and_bag) {
  const ProgramRun first = run(STL_PROGRAM_DIR "/simulate_bag", "");
  EXPECT_EQ(first.status, 0) << first.err;
  EXPECT_TRUE(exists("associations.txt"));
  EXPECT_GT(std::filesystem::file_size(directory_.path("made/sequence.bag")), 4u * 96u * 72u * 3u / 2u);
}

TEST_F(SimulateProgram, the_same_request_is_not_made_again) {
  EXPECT_EQ(run(STL_PROGRAM_DIR "/simulate", "--images true").status, 0);
  const auto written = std::filesystem::last_write_time(directory_.path("made/rgb.txt"));
  const ProgramRun again = run(STL_PROGRAM_DIR "/simulate", "--images true --threads 1");
  EXPECT_EQ(again.status, 0);
  EXPECT_NE(again.out.find("up to date"), std::string::npos) << again.out;
  EXPECT_EQ(std::filesystem::last_write_time(directory_.path("made/rgb.txt")), written);
  const ProgramRun other = run(STL_PROGRAM_DIR "/simulate", "--images true --seed 2");
  EXPECT_EQ(other.status, 0);
  EXPECT_EQ(other.out.find("up to date"), std::string::npos) << other.out;
}

TEST_F(SimulateProgram, half_made_directories_are_made_again) {
  EXPECT_EQ(run(STL_PROGRAM_DIR "/simulate", "--images true").status, 0);
  // A request that fails after it has begun leaves no manifest.
  EXPECT_EQ(run(STL_PROGRAM_DIR "/simulate", "--images true --set drift.position_m=-1").status, 1);
  EXPECT_TRUE(exists("manifest.txt")) << "nothing was begun";
  EXPECT_EQ(run(STL_PROGRAM_DIR "/simulate", "--images true --bag @none/a.bag").status, 1);
  EXPECT_FALSE(exists("manifest.txt"));
}

TEST_F(SimulateProgram, wrong_arguments_are_named) {
  for (const auto& [arguments, part] :
       {std::pair("--images maybe", "--images 'maybe' must be true or false"),
        std::pair("--threads 0", "--threads '0'"),
        std::pair("--bag-compression zip", "--bag-compression 'zip' must be bz2, lz4 or none"),
        std::pair("--bag-images 1", "--bag-images '1'")}) {
    const ProgramRun failed = run(STL_PROGRAM_DIR "/simulate", arguments);
    EXPECT_EQ(failed.status, 2) << arguments;
    EXPECT_NE(failed.err.find(part), std::string::npos) << failed.err;
  }
  const ProgramRun failed = run(STL_PROGRAM_DIR "/simulate", "--set rendering.depth_scale=-5");
  EXPECT_EQ(failed.status, 1);
  EXPECT_NE(failed.err.find("rendering.depth_scale"), std::string::npos) << failed.err;
}

}  // namespace
}  // namespace semantic_topo_loop::core
