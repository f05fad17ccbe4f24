#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <regex>
#include <string>

namespace {

namespace fs = std::filesystem;

/// The core must stay usable without ROS.
TEST(Layering, CoreIncludesNoRosHeader) {
  const std::regex ros(
      "#include *<(ros|nodelet|tf2|tf2_ros|rosbag|[a-z_]+_msgs)/.*|#include.*semantic_topo_loop/(ros/|[A-Z]).*");
  int files = 0;
  for (const std::string root : {STL_SOURCE_DIR "/include/semantic_topo_loop", STL_SOURCE_DIR "/src"}) {
    for (const std::string module : {"geometry", "detection", "association", "map", "loop", "pose_graph", "pipeline",
                                     "io", "simulation", "evaluation"}) {
      for (const auto& entry : fs::directory_iterator(fs::path(root) / module)) {
        std::ifstream file(entry.path());
        ++files;
        for (std::string line; std::getline(file, line);) {
          EXPECT_FALSE(std::regex_match(line, ros)) << entry.path() << ": " << line;
        }
      }
    }
  }
  EXPECT_GT(files, 100);
}

}  // namespace
