#include "semantic_topo_loop/loop/loop_options.h"

#include <initializer_list>
#include <sstream>

namespace semantic_topo_loop::core {
namespace {

template <class Value>
bool reject(const char* key, const Value& value, const char* expected, std::string* error) {
  std::ostringstream message;
  message << "parameter '" << key << "' = '" << value << "' must be " << expected;
  if (error != nullptr) *error = message.str();
  return false;
}

struct Named {
  template <class Value>
  Named(const char* name, Value number) : key(name), value(static_cast<double>(number)) {}

  const char* key;
  double value;
};

bool all_at_least(std::initializer_list<Named> values, double minimum, const char* expected, std::string* error) {
  for (const Named& named : values) {
    if (!(named.value >= minimum)) return reject(named.key, named.value, expected, error);
  }
  return true;
}

bool all_positive(std::initializer_list<Named> values, std::string* error) {
  for (const Named& named : values) {
    if (!(named.value > 0.0)) return reject(named.key, named.value, "> 0", error);
  }
  return true;
}

bool all_shares(std::initializer_list<Named> values, std::string* error) {
  for (const Named& named : values) {
    if (!(named.value >= 0.0 && named.value <= 1.0)) return reject(named.key, named.value, "in [0, 1]", error);
  }
  return true;
}

}  // namespace

bool LoopOptions::is_valid(std::string* error) const {
  if (mode != "graph" && mode != "paper") return reject("loop.mode", mode, "graph or paper", error);
  if (score != "corrected" && score != "printed") return reject("loop.score", score, "corrected or printed", error);
  if (scale != "fixed" && scale != "free") return reject("loop.scale", scale, "fixed or free", error);
  if (min_window_s > window_s) return reject("loop.min_window_s", min_window_s, "<= loop.window_s", error);
  return all_positive({{"loop.min_gap_s", min_gap_s},
                       {"loop.window_s", window_s},
                       {"loop.min_window_s", min_window_s},
                       {"loop.window_drift_deg", window_drift_deg},
                       {"loop.store_interval_s", store_interval_s},
                       {"loop.min_parallax_deg", min_parallax_deg},
                       {"loop.max_depth_m", max_depth_m},
                       {"loop.max_radius_m", max_radius_m},
                       {"loop.up_window_s", up_window_s},
                       {"loop.size_ratio_log", size_ratio_log},
                       {"loop.distance_tolerance_m", distance_tolerance_m},
                       {"loop.inlier_distance_m", inlier_distance_m},
                       {"loop.max_rms_m", max_rms_m},
                       {"loop.max_tilt_deg", max_tilt_deg},
                       {"loop.refine_sigma_px", refine_sigma_px},
                       {"loop.refine_max_residual", refine_max_residual},
                       {"loop.refine_max_shift_m", refine_max_shift_m},
                       {"loop.refine_max_shift_deg", refine_max_shift_deg},
                       {"loop.covariance_inflation", covariance_inflation},
                       {"loop.max_sigma_m", max_sigma_m},
                       {"loop.max_sigma_deg", max_sigma_deg},
                       {"loop.paper_window_s", paper_window_s}},
                      error) &&
         all_at_least({{"loop.frame_interval_s", frame_interval_s},
                       {"loop.attempt_interval_s", attempt_interval_s},
                       {"loop.distance_tolerance_share", distance_tolerance_share},
                       {"loop.min_distance_m", min_distance_m},
                       {"loop.min_spread_m", min_spread_m},
                       {"loop.refine_sigma_share", refine_sigma_share},
                       {"loop.paper_printed_min_score", paper_printed_min_score},
                       {"loop.paper_corrected_min_score", paper_corrected_min_score}},
                      0.0, ">= 0", error) &&
         all_shares({{"loop.min_seen_share", min_seen_share},
                     {"loop.reprojection_iou", reprojection_iou},
                     {"loop.min_explained_share", min_explained_share},
                     {"loop.min_reprojection_ratio", min_reprojection_ratio}},
                    error) &&
         all_at_least({{"loop.ambiguity_ratio", ambiguity_ratio},
                       {"loop.max_candidates", max_candidates},
                       {"loop.min_labels", min_labels},
                       {"loop.min_reprojected_objects", min_reprojected_objects},
                       {"loop.refine_views", refine_views},
                       {"loop.paper_min_gap_frames", paper_min_gap_frames},
                       {"loop.paper_consistency", paper_consistency}},
                      1.0, ">= 1", error) &&
         all_at_least({{"loop.min_views", min_views},
                       {"loop.fit_views", fit_views},
                       {"loop.min_inliers", min_inliers},
                       {"loop.paper_min_common", paper_min_common}},
                      3.0, ">= 3", error);
}

}  // namespace semantic_topo_loop::core
