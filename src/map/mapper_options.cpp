#include "semantic_topo_loop/map/mapper_options.h"

#include <sstream>
#include <utility>

namespace semantic_topo_loop::core {

bool QuadricMapperOptions::is_valid(std::string* error) const {
  const auto fail = [error](const char* name, double value, const char* rule) {
    std::ostringstream message;
    message << "parameter 'mapping." << name << "' = " << value << " must be " << rule;
    if (error != nullptr) *error = message.str();
    return false;
  };
  if (min_views < 3) return fail("min_views", min_views, ">= 3");
  if (fit_views_max < min_views) return fail("fit_views_max", fit_views_max, ">= mapping.min_views");
  if (!(size_prior_factor > 1.0)) return fail("size_prior_factor", size_prior_factor, "> 1");
  for (const auto& [name, value] :
       {std::pair("refit_growth", refit_growth), std::pair("max_depth_m", max_depth_m),
        std::pair("max_semi_axis_m", max_semi_axis_m), std::pair("maintenance_interval_s", maintenance_interval_s),
        std::pair("forget_candidate_s", forget_candidate_s), std::pair("retire_expected_s", retire_expected_s),
        std::pair("retire_missed_s", retire_missed_s), std::pair("retire_seen_through_s", retire_seen_through_s)}) {
    if (!(value > 0.0)) return fail(name, value, "> 0");
  }
  for (const auto& [name, value] :
       {std::pair("confirm_seen_s", confirm_seen_s), std::pair("forget_candidate_seen_s", forget_candidate_seen_s)}) {
    if (!(value >= 0.0)) return fail(name, value, ">= 0");
  }
  for (const auto& [name, value] :
       {std::pair("min_baseline_deg", min_baseline_deg), std::pair("confirm_baseline_deg", confirm_baseline_deg)}) {
    if (!(value >= 0.0 && value < 180.0)) return fail(name, value, "in [0, 180)");
  }
  for (const auto& [name, value] :
       {std::pair("min_fit_iou", min_fit_iou), std::pair("merge_iou", merge_iou),
        std::pair("merge_iou_confusable", merge_iou_confusable), std::pair("merge_veto_share", merge_veto_share),
        std::pair("confirm_mean_iou", confirm_mean_iou), std::pair("confirm_seen_share", confirm_seen_share),
        std::pair("confirm_quality", confirm_quality), std::pair("retire_seen_share", retire_seen_share)}) {
    if (!(value >= 0.0 && value <= 1.0)) return fail(name, value, "in [0, 1]");
  }
  return true;
}

}  // namespace semantic_topo_loop::core
