#include "ros/rgbd_frontend_parameters.h"

#include <utility>

#include "ros/parameter_check.h"

namespace semantic_topo_loop {

bool RgbdFrontendParameters::is_valid(std::string* error) const {
  if (!FrontendParameters::is_valid(error)) return false;
  for (const auto& [key, value] :
       {std::pair("color_transport", color_transport), std::pair("depth_transport", depth_transport)}) {
    if (value.empty()) return fail(key, value, "given", error);
  }
  for (const auto& [key, value] :
       {std::pair("color_queue_size", color_queue_size), std::pair("depth_queue_size", depth_queue_size),
        std::pair("sync_queue_size", sync_queue_size)}) {
    if (value < 1) return fail(key, value, "at least 1", error);
  }
  for (const auto& [key, value] :
       {std::pair("max_depth_delay_s", max_depth_delay_s), std::pair("pair_timeout_s", pair_timeout_s),
        std::pair("starvation_s", starvation_s)}) {
    if (!(value > 0.0)) return fail(key, value, "> 0", error);
  }
  return true;
}

}  // namespace semantic_topo_loop
