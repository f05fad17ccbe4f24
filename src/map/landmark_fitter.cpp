#include "map/landmark_fitter.h"

#include <algorithm>

#include "map/quadric_initialisation.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kMinDepth_m = 0.2;
constexpr int kMinNewViews = 5;
constexpr std::size_t kSurfaceViews = 24;  // more show nothing new and each costs as much as a box

}  // namespace

bool LandmarkFitter::fit(const ViewSource& source, MappedLandmark* landmark) const {
  Landmark& state = landmark->state;
  landmark->next_fit_at =
      state.observations + std::max(kMinNewViews, static_cast<int>(options_.refit_growth * state.observations));
  landmark->fit_due = false;
  const std::vector<BoxView> views = fit_views(source, *landmark);
  const bool has_depth =
      std::any_of(views.begin(), views.end(), [](const BoxView& view) { return view.surface != nullptr; });
  if (!has_depth && static_cast<int>(views.size()) < options_.min_views) return false;
  const std::optional<Ellipsoid> initial = state.ellipsoid ? state.ellipsoid : start(source.camera(), views, state);
  if (!initial) return false;
  const std::optional<QuadricFit> fit = refine_quadric(source.camera(), views, *initial);
  if (!fit || !is_sane(*fit, state.class_id)) return false;
  state.ellipsoid = fit->ellipsoid;
  state.center_covariance = fit->center_covariance;
  state.mean_iou = fit->mean_iou;
  state.baseline_deg = parallax_deg(views, fit->ellipsoid.center());
  state.anchor_keyframe_id = landmark->observations[landmark->observations.size() / 2].keyframe_id;
  return true;
}

/// From the depth inside one box if there is any, else from several boxes with parallax.
std::optional<Ellipsoid> LandmarkFitter::start(const Camera& camera, const std::vector<BoxView>& views,
                                               const Landmark& state) const {
  const ObjectClass* object_class = classes_.find(state.class_id);
  for (auto view = views.rbegin(); view != views.rend(); ++view) {
    const std::optional<Ellipsoid> ellipsoid =
        initialise_from_surface(camera, *view, object_class != nullptr ? object_class->size_prior_m : 0.0);
    if (ellipsoid) return ellipsoid;
  }
  if (static_cast<int>(views.size()) < options_.min_views) return std::nullopt;
  const std::optional<Ellipsoid> sphere = initialise_sphere(camera, views);
  return sphere && parallax_deg(views, sphere->center()) >= options_.min_baseline_deg ? sphere : std::nullopt;
}

/// Boxes of the landmark's class or one confused with it, whole ones first; what the image border cuts fills up, since
/// of a large object seen from near there may be nothing else. Those with depth come before both.
std::vector<BoxView> LandmarkFitter::fit_views(const ViewSource& source, const MappedLandmark& landmark) const {
  std::vector<Observation> with_depth, whole, cut;
  for (const Observation& observation : landmark.observations) {
    if (!classes_.confusable(observation.class_id, landmark.state.class_id)) continue;
    (observation.view.surface ? with_depth : observation.view.truncated == 0 ? whole : cut).push_back(observation);
  }
  const auto wanted = static_cast<std::size_t>(options_.fit_views_max);
  std::vector<BoxView> views = source.views(spread(with_depth, std::min(wanted, kSurfaceViews)));
  for (const std::vector<Observation>* rest : {&whole, &cut}) {
    if (views.size() >= wanted) break;
    const std::vector<BoxView> more = source.views(spread(*rest, wanted - views.size()));
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
