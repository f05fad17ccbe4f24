#include "ros/player_parameters.h"

#include <iterator>
#include <sstream>
#include <utility>

#include "ros/parameter_check.h"

namespace semantic_topo_loop {

bool PlayerParameters::is_valid(std::string* error) const {
  if (!StageParameters::is_valid(error)) return false;
  const auto is_one_of = [error](const char* key, const std::string& value, const char* a, const char* b) {
    return value == a || value == b || fail(key, value, std::string(a) + " or " + b, error);
  };
  if (!is_one_of("mode", mode, "files", "bag") || !is_one_of("stamps", stamps, "image", "camera_info") ||
      !is_one_of("mocap_tf", mocap_tf, "drop", "odom")) {
    return false;
  }
  for (const auto& [key, value] :
       {std::pair("max_pose_gap_s", max_pose_gap_s), std::pair("max_depth_delay_s", max_depth_delay_s),
        std::pair("rate", rate), std::pair("startup_timeout_s", startup_timeout_s),
        std::pair("stall_timeout_s", stall_timeout_s)}) {
    if (!(value > 0.0)) return fail(key, value, "> 0", error);
  }
  if (mode == "files" && trajectory_file.empty()) return fail("trajectory_file", "", "given in mode files", error);
  if (mode == "files" && camera_file.empty()) return fail("camera_file", "", "given in mode files", error);
  if (mode == "bag" && bag_file.empty()) return fail("bag_file", "", "given in mode bag", error);
  if (images && (mode != "bag" || stamps != "image")) {
    return fail("images", "true", "false unless mode is bag and stamps is image", error);
  }
  if (credit < 1 || credit >= queue_size) return fail("credit", credit, "at least 1 and less than queue_size", error);
  return true;
}

std::vector<std::string> PlayerParameters::stage_names() const {
  std::istringstream words(stages);
  return {std::istream_iterator<std::string>(words), std::istream_iterator<std::string>()};
}

}  // namespace semantic_topo_loop
