#pragma once

#include <gtest/gtest.h>
#include <sys/wait.h>

#include <algorithm>
#include <cstdlib>
#include <string>
#include <utility>

#include "support/test_files.h"

namespace semantic_topo_loop::core {

/// What a program printed and how it ended.
struct ProgramRun {
  int status = -1;
  std::string out, err;
};

/// @param arguments with "@" for the test's directory, which receives the outputs
inline ProgramRun run_program(const std::string& program, std::string arguments, const TestDirectory& directory) {
  for (std::size_t at = arguments.find('@'); at != std::string::npos; at = arguments.find('@', at)) {
    arguments.replace(at, 1, directory.path(""));
  }
  const std::string out = directory.path("out"), err = directory.path("err");
  const int status = std::system((program + " " + arguments + " >" + out + " 2>" + err).c_str());
  return {WIFEXITED(status) ? WEXITSTATUS(status) : -1, read_whole(out), read_whole(err)};
}

/// Runs a program on files of the test's own.
class ProgramTest : public ::testing::Test {
 protected:
  explicit ProgramTest(std::string program) : program_(std::move(program)) {}

  /// @return the exit status; "@" in the arguments stands for the test's directory
  int run(const std::string& arguments) {
    const ProgramRun run = run_program(program_, arguments, directory_);
    out_ = run.out;
    err_ = run.err;
    return run.status;
  }
  void expect_one_line_error(const std::string& part) const {
    EXPECT_TRUE(out_.empty()) << out_;
    EXPECT_NE(err_.find(part), std::string::npos) << err_;
    EXPECT_EQ(std::count(err_.begin(), err_.end(), '\n'), 1) << err_;
  }

  void expect_failure(const std::string& arguments, int status, const std::string& part) {
    EXPECT_EQ(run(arguments), status) << arguments;
    expect_one_line_error(part);
  }

  std::string program_;
  TestDirectory directory_;
  std::string out_, err_;
};

}  // namespace semantic_topo_loop::core
