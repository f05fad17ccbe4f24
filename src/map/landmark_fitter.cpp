#include "landmark_fitter.h"

#include <algorithm>

#include "semantic_topo_loop/map/quadric_initialisation.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kMinDepth_m = 0.2;
constexpr int kMinNewViews = 5;

}  // namespace

bool LandmarkFitter::fit(const ViewSource& source, MappedLandmark* landmark) const {
  Landmark& state = landmark->state;
  landmark->next_fit_at =
      state.observations + std::max(kMinNewViews, static_cast<int>(options_.refit_growth * state.observations));
  landmark->fit_due = false;
  const std::vector<BoxView> views = fit_views(source, *landmark);
  if (static_cast<int>(views.size()) < options_.min_views) return false;
  const bool is_first = state.mean_iou == 0.0;
  const std::optional<Ellipsoid> initial =
      is_first || !state.ellipsoid ? initialise_sphere(source.camera(), views) : state.ellipsoid;
  if (!initial || (is_first && parallax_deg(views, initial->center()) < options_.min_baseline_deg)) return false;
  const std::optional<QuadricFit> fit = refine_quadric(source.camera(), views, *initial);
  if (!fit || !is_sane(*fit, state.class_id)) return false;
  state.ellipsoid = fit->ellipsoid;
  state.center_covariance = fit->center_covariance;
  state.mean_iou = fit->mean_iou;
  state.baseline_deg = parallax_deg(views, fit->ellipsoid.center());
  state.anchor_keyframe_id = landmark->observations[landmark->observations.size() / 2].keyframe_id;
  return true;
}

/// Boxes of the landmark's class or one confused with it, whole ones first; what the image border cuts fills up, since
/// of a large object seen from near there may be nothing else.
std::vector<BoxView> LandmarkFitter::fit_views(const ViewSource& source, const MappedLandmark& landmark) const {
  std::vector<Observation> whole, cut;
  for (const Observation& observation : landmark.observations) {
    if (!classes_.confusable(observation.class_id, landmark.state.class_id)) continue;
    (observation.truncated == 0 ? whole : cut).push_back(observation);
  }
  const auto wanted = static_cast<std::size_t>(options_.fit_views_max);
  std::vector<BoxView> views = source.views(spread(whole, wanted));
  if (views.size() < wanted) {
    const std::vector<BoxView> more = source.views(spread(cut, wanted - views.size()));
    views.insert(views.end(), more.begin(), more.end());
  }
  return views;
}

bool LandmarkFitter::is_sane(const QuadricFit& fit, int class_id) const {
  const ObjectClass* object_class = classes_.find(class_id);
  if (object_class != nullptr && object_class->size_prior_m > 0.0) {
    const double ratio = 2.0 * fit.ellipsoid.radius() / object_class->size_prior_m;
    if (ratio > options_.size_prior_factor || ratio * options_.size_prior_factor < 1.0) return false;
  }
  return fit.median_depth_m > kMinDepth_m && fit.median_depth_m < options_.max_depth_m &&
         fit.ellipsoid.semi_axes.maxCoeff() < options_.max_semi_axis_m && fit.mean_iou > options_.min_fit_iou;
}

}  // namespace semantic_topo_loop::core
