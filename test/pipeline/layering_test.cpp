#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <map>
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
    for (const std::string module : {"geometry", "frontend", "detection", "association", "map", "loop", "pose_graph",
                                     "pipeline", "io", "simulation", "evaluation"}) {
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

/// Two types of one name in one namespace would share the symbols of their templates, whichever is linked first.
TEST(Layering, NoTwoFilesDefineTheSameType) {
  const std::regex definition("(struct|class) ([A-Za-z0-9_]+)( final)?( :.*)? \\{.*");
  std::map<std::string, std::string> file_of;
  for (const std::string root : {STL_SOURCE_DIR "/include/semantic_topo_loop", STL_SOURCE_DIR "/src"}) {
    for (const auto& entry : fs::recursive_directory_iterator(root)) {
      if (entry.path().extension() != ".h") continue;
      std::ifstream file(entry.path());
      for (std::string line; std::getline(file, line);) {
        std::smatch match;
        if (!std::regex_match(line, match, definition)) continue;
        const auto [known, is_new] = file_of.emplace(match[2].str(), entry.path().string());
        EXPECT_TRUE(is_new) << match[2] << " is defined in " << known->second << " and " << entry.path();
      }
    }
  }
  EXPECT_GT(file_of.size(), 100u);
}

}  // namespace
