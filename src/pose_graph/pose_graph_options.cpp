#include "semantic_topo_loop/pose_graph/pose_graph_options.h"

#include <sstream>

namespace semantic_topo_loop::core {
namespace {

template <class Value>
bool check(bool is_good, const char* key, const Value& value, const char* requirement, std::string* error) {
  if (is_good) return true;
  std::ostringstream message;
  message << "parameter 'pose_graph." << key << "' = '" << value << "' must be " << requirement;
  if (error != nullptr) *error = message.str();
  return false;
}

}  // namespace

bool PoseGraphOptions::is_valid(std::string* error) const {
  const bool is_known = robust == "gnc" || robust == "cauchy" || robust == "huber" || robust == "none";
  return check(is_known, "robust", robust, "gnc, cauchy, huber or none", error) &&
         check(robust_chi2 > 0.0, "robust_chi2", robust_chi2, "> 0", error) &&
         check(gnc_loosening >= 1.0, "gnc_loosening", gnc_loosening, ">= 1", error) &&
         check(interval_keyframes >= 1, "interval_keyframes", interval_keyframes, ">= 1", error) &&
         check(min_interval_keyframes >= 1 && min_interval_keyframes <= interval_keyframes, "min_interval_keyframes",
               min_interval_keyframes, "in 1..interval_keyframes", error) &&
         check(urgent_chi2 >= 0.0, "urgent_chi2", urgent_chi2, ">= 0", error) &&
         check(translation_noise_m > 0.0, "translation_noise_m", translation_noise_m, "> 0", error) &&
         check(rotation_noise_deg > 0.0, "rotation_noise_deg", rotation_noise_deg, "> 0", error) &&
         check(noise_factor_max >= 1.0, "noise_factor_max", noise_factor_max, ">= 1", error) &&
         check(noise_evidence >= 0.0, "noise_evidence", noise_evidence, ">= 0", error) &&
         check(max_redundancy > 0.0, "max_redundancy", max_redundancy, "> 0", error) &&
         check(max_iterations >= 1, "max_iterations", max_iterations, ">= 1", error) &&
         check(scale == "fixed" || scale == "free", "scale", scale, "fixed or free", error) &&
         check(scale_walk > 0.0 && scale_walk <= 0.5, "scale_walk", scale_walk, "in (0, 0.5]", error) &&
         check(objects == "off" || objects == "with_loops" || objects == "on", "objects", objects,
               "off, with_loops or on", error) &&
         check(object_weight > 0.0, "object_weight", object_weight, "> 0", error) &&
         check(object_sigma_px > 0.0, "object_sigma_px", object_sigma_px, "> 0", error) &&
         check(object_sigma_share >= 0.0, "object_sigma_share", object_sigma_share, ">= 0", error) &&
         check(object_views >= 4, "object_views", object_views, ">= 4", error);
}

}  // namespace semantic_topo_loop::core
