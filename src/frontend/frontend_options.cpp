#include "semantic_topo_loop/frontend/frontend_options.h"

#include <sstream>

namespace semantic_topo_loop::core {

bool FrontendOptions::is_valid(std::string* error) const {
  const auto fail = [error](const char* name, double value, const char* rule) {
    std::ostringstream message;
    message << "parameter 'frontend." << name << "' = " << value << " must be " << rule;
    if (error != nullptr) *error = message.str();
    return false;
  };
  if (features < 100 || features > 10000) return fail("features", features, "in [100, 10000]");
  if (levels < 1 || levels > 12) return fail("levels", levels, "in [1, 12]");
  if (!(scale_factor > 1.0 && scale_factor <= 2.0)) return fail("scale_factor", scale_factor, "in (1, 2]");
  if (corner_threshold < 1 || corner_threshold > 100) return fail("corner_threshold", corner_threshold, "in [1, 100]");
  if (registration_px < 0 || registration_px > 50) return fail("registration_px", registration_px, "in [0, 50]");
  if (min_inliers < 6) return fail("min_inliers", min_inliers, ">= 6");
  if (!(restart_after_s >= 0.0)) return fail("restart_after_s", restart_after_s, ">= 0");
  if (window_keyframes < 2) return fail("window_keyframes", window_keyframes, ">= 2");
  if (window_iterations < 1) return fail("window_iterations", window_iterations, ">= 1");
  if (max_keyframes < 2 * window_keyframes) {
    return fail("max_keyframes", max_keyframes, ">= 2 frontend.window_keyframes");
  }
  if (point_stride_px < 1) return fail("point_stride_px", point_stride_px, ">= 1");
  return true;
}

}  // namespace semantic_topo_loop::core
