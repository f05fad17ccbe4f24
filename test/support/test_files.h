#pragma once

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <opencv2/core/version.hpp>
#include <optional>
#include <sstream>
#include <string>

#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// A directory of one test, removed at its end.
class TestDirectory {
 public:
  TestDirectory() {
    std::string pattern = (std::filesystem::temp_directory_path() / "semantic_topo_loop_test_XXXXXX").string();
    path_ = ::mkdtemp(pattern.data());
  }
  ~TestDirectory() { std::filesystem::remove_all(path_); }
  TestDirectory(const TestDirectory&) = delete;
  TestDirectory& operator=(const TestDirectory&) = delete;

  std::string path(const std::string& name) const { return path_ + "/" + name; }

  /// Writes a file and gives its path.
  std::string write(const std::string& name, const std::string& text) const {
    std::filesystem::create_directories(std::filesystem::path(path(name)).parent_path());
    std::ofstream(path(name), std::ios::binary) << text;
    return path(name);
  }

 private:
  std::string path_;
};

/// Bounds the size of files, as a full disk does, until the end of a scope.
class SmallFiles {
 public:
  explicit SmallFiles(rlim_t bytes) : handler_(std::signal(SIGXFSZ, SIG_IGN)) {
    ::getrlimit(RLIMIT_FSIZE, &before_);
    const rlimit small{bytes, before_.rlim_max};
    ::setrlimit(RLIMIT_FSIZE, &small);
  }
  ~SmallFiles() {
    ::setrlimit(RLIMIT_FSIZE, &before_);
    std::signal(SIGXFSZ, handler_);
  }
  SmallFiles(const SmallFiles&) = delete;
  SmallFiles& operator=(const SmallFiles&) = delete;

 private:
  rlimit before_{};
  void (*handler_)(int);
};

/// The value of a result; without one a failure that says why, and an empty value.
template <class Value>
Value checked(const Result<Value>& result) {
  EXPECT_TRUE(result) << result.message();
  return result ? *result : Value();
}

inline std::string read_whole(const std::string& path) {
  std::ostringstream text;
  text << std::ifstream(path, std::ios::binary).rdbuf();
  return text.str();
}

/// What stands in a page of the documentation between the lines that name the command that prints it.
inline std::string generated_part(const std::string& page, const std::string& command) {
  const std::string text = read_whole(page), begin = "<!-- begin " + command + " -->\n";
  const std::size_t from = text.find(begin), to = text.find("<!-- end " + command + " -->");
  if (from == std::string::npos || to == std::string::npos) return page + " has no part of " + command;
  return text.substr(from + begin.size(), to - from - begin.size());
}

/// A path in the shared recordings, or nullopt without them: GTEST_SKIP() then.
inline std::optional<std::string> shared_data(const std::string& name) {
  const char* root = std::getenv("SEMANTIC_TOPO_LOOP_DATA");
  if (root == nullptr || *root == '\0') return std::nullopt;
  const std::string path = std::string(root) + "/" + name;
  return std::filesystem::exists(path) ? std::optional(path) : std::nullopt;
}

/// Such a folder, or nullopt where it does not hold that file.
inline std::optional<std::string> shared_folder(const std::string& name, const std::string& file) {
  return shared_data(name + "/" + file) ? shared_data(name) : std::nullopt;
}

/// A real network, or nullopt where there is none or OpenCV cannot run it: GTEST_SKIP() then.
inline std::optional<std::string> shared_detector() {
  constexpr bool kHasStridedSlices = CV_VERSION_MAJOR * 100 + CV_VERSION_MINOR >= 406;  // 4.5.1 has none
  return kHasStridedSlices ? shared_data("models/yolox_nano.onnx") : std::nullopt;
}

}  // namespace semantic_topo_loop::core
