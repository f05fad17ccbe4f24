#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <map>
#include <regex>
#include <set>
#include <string>
#include <utility>
#include <vector>

namespace {

namespace fs = std::filesystem;

using Names = std::set<std::string>;

Names operator+(Names a, const Names& b) {
  a.insert(b.begin(), b.end());
  return a;
}

/// Module -> the modules that its files may include, besides its own. The picture is in docs/architecture.md.
std::map<std::string, Names> allowed_arrows() {
  const Names ground = {"types", "geometry", "odometry"};
  const Names stages = {"frontend", "association", "map", "loop", "pose_graph"};
  const Names core = ground + stages + Names{"pipeline", "io"};
  std::map<std::string, Names> arrows = {{"types", {}}, {"geometry", {"types"}}, {"odometry", {"types", "geometry"}}};
  for (const std::string& stage : stages) arrows[stage] = ground;
  arrows["pipeline"] = ground + stages;
  arrows["io"] = ground + stages + Names{"pipeline"};
  arrows["tools"] = core;
  arrows["ros"] = core;
  arrows["nodelets"] = core + Names{"ros"};
  arrows["rviz_plugin"] = core + Names{"ros"};
  arrows["apps"] = core + Names{"ros", "tools"};
  return arrows;
}

/// Folders of one module of which the first may not include the second.
const std::vector<std::pair<std::string, std::string>> kStrangers = {{"loop/graph", "loop/paper"},
                                                                     {"loop/paper", "loop/graph"},
                                                                     {"loop/submap", "loop/graph"},
                                                                     {"loop/submap", "loop/paper"}};

const Names kRosModules = {"ros", "nodelets", "apps", "rviz_plugin"};
/// What the core may include from outside; a public header of the core Eigen and OpenCV's matrix alone.
const std::regex kCoreLibrary("(Eigen|boost|ceres|ext|nlohmann|opencv2|pcl|sys|yaml-cpp)/.*");
const std::regex kPublicLibrary("Eigen/.*|opencv2/core.hpp");
constexpr size_t kMaxPublicHeaders = 70;
/// What our nodelets have through ros/stage.h and other packages' nodes need by itself.
const Names kForOtherPackages = {"ros/messages.h"};

struct Include {
  std::string file;      ///< path of the includer below its root, e.g. loop/loop_detector.cpp
  bool in_public;        ///< whether the includer is a public header
  std::string included;  ///< path below its root, or as written if it is not ours
  bool is_public;        ///< whether it names a public header of ours
  bool is_private;       ///< whether it names a private one
};

std::string module_of(const std::string& path) { return path.substr(0, path.find('/')); }

bool is_below(const std::string& path, const std::string& folder) { return path.rfind(folder + "/", 0) == 0; }

/// Every file of a root (relative path -> absolute).
std::map<std::string, fs::path> files_below(const fs::path& root) {
  std::map<std::string, fs::path> files;
  for (const auto& entry : fs::recursive_directory_iterator(root)) {
    const std::string extension = entry.path().extension().string();
    if (extension != ".h" && extension != ".cpp") continue;
    files.emplace(entry.path().lexically_relative(root).generic_string(), entry.path());
  }
  return files;
}

class Layering : public ::testing::Test {
 protected:
  void SetUp() override {
    public_ = files_below(STL_SOURCE_DIR "/include/semantic_topo_loop");
    private_ = files_below(STL_SOURCE_DIR "/src");
    read(public_, true);
    read(private_, false);
    ASSERT_GT(includes_.size(), 500u);
  }

  void read(const std::map<std::string, fs::path>& files, bool in_public) {
    static const std::regex line_of_include("#include *([<\"])([^>\"]+)[>\"].*");
    const std::string prefix = "semantic_topo_loop/";
    for (const auto& [name, path] : files) {
      std::ifstream file(path);
      for (std::string line; std::getline(file, line);) {
        std::smatch match;
        if (!std::regex_match(line, match, line_of_include)) continue;
        const std::string written = match[2];
        const bool ours = written.rfind(prefix, 0) == 0 && public_.count(written.substr(prefix.size()));
        const bool beside = match[1] == "\"" && private_.count(written);
        includes_.push_back({name, in_public, ours ? written.substr(prefix.size()) : written, ours, beside});
      }
    }
  }

  std::map<std::string, fs::path> public_, private_;
  std::vector<Include> includes_;
};

TEST_F(Layering, IncludesFollowTheArrows) {
  const auto arrows = allowed_arrows();
  std::set<std::pair<std::string, std::string>> drawn;
  for (const Include& i : includes_) {
    if (!i.is_public && !i.is_private) continue;
    const std::string from = module_of(i.file), to = module_of(i.included);
    ASSERT_TRUE(arrows.count(from)) << i.file << " is in no module of the table";
    if (from != to) {
      drawn.emplace(from, to);
      EXPECT_TRUE(arrows.at(from).count(to)) << i.file << " includes " << i.included;
    }
    for (const auto& [a, b] : kStrangers) {
      EXPECT_FALSE(is_below(i.file, a) && is_below(i.included, b)) << i.file << " includes " << i.included;
    }
  }
  for (const auto& [from, to] : drawn) EXPECT_FALSE(drawn.count({to, from})) << from << " and " << to << " are mutual";
}

/// The core must stay usable without ROS; what is installed must build with what the package exports.
TEST_F(Layering, CoreIncludesNoRosHeader) {
  for (const Include& i : includes_) {
    const bool ours = i.is_public || i.is_private, in_folder = i.included.find('/') != std::string::npos;
    if (ours || !in_folder || kRosModules.count(module_of(i.file))) continue;
    EXPECT_TRUE(std::regex_match(i.included, i.in_public ? kPublicLibrary : kCoreLibrary))
        << i.file << " includes " << i.included;
  }
}

TEST_F(Layering, PublicHeadersIncludeNoPrivateOne) {
  for (const Include& i : includes_) {
    EXPECT_FALSE(i.in_public && i.is_private) << i.file << " includes " << i.included;
  }
}

/// A header is public because another module uses it, or a public header that another module uses.
TEST_F(Layering, PublicHeadersAreUsedOutsideTheirModule) {
  EXPECT_LE(public_.size(), kMaxPublicHeaders);
  Names used = kForOtherPackages;
  for (const Include& i : includes_) {
    if (i.is_public && module_of(i.file) != module_of(i.included)) used.insert(i.included);
  }
  for (size_t before = 0; before != used.size();) {
    before = used.size();
    for (const Include& i : includes_) {
      if (i.is_public && i.in_public && used.count(i.file)) used.insert(i.included);
    }
  }
  for (const auto& [header, path] : public_) EXPECT_TRUE(used.count(header)) << path << " could be private";
}

/// Two types of one name in one namespace would share the symbols of their templates, whichever is linked first.
TEST_F(Layering, NoTwoFilesDefineTheSameType) {
  const std::regex definition("(struct|class) ([A-Za-z0-9_]+)( final)?( :.*)? \\{.*");
  std::map<std::string, std::string> file_of;
  for (const auto* files : {&public_, &private_}) {
    for (const auto& [name, path] : *files) {
      if (path.extension() != ".h") continue;
      std::ifstream file(path);
      for (std::string line; std::getline(file, line);) {
        std::smatch match;
        if (!std::regex_match(line, match, definition)) continue;
        const auto [known, is_new] = file_of.emplace(match[2].str(), path.string());
        EXPECT_TRUE(is_new) << match[2] << " is defined in " << known->second << " and " << path;
      }
    }
  }
  EXPECT_GT(file_of.size(), 100u);
}

}  // namespace
