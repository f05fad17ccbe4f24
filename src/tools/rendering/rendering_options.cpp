#include "tools/rendering/rendering_options.h"

#include "tools/simulation/option_check.h"

namespace semantic_topo_loop::core {

bool RenderingOptions::is_valid(std::string* error) const {
  OptionCheck check(error);
  // 16 bits must reach the camera's 6 m, and a step must not exceed a centimetre.
  check.require(depth_scale >= 100.0 && depth_scale <= 10000.0, "rendering.depth_scale", depth_scale,
                "in [100, 10000]");
  check.require(far_value == 0 || far_value == 65535, "rendering.far_value", far_value, "0 or 65535");
  check.require(std::abs(depth_delay_s) <= 0.1, "rendering.depth_delay_s", depth_delay_s, "in [-0.1, 0.1]");
  check.require(std::abs(depth_offset_m) <= 0.2, "rendering.depth_offset_m", depth_offset_m, "in [-0.2, 0.2]");
  return check.ok();
}

}  // namespace semantic_topo_loop::core
