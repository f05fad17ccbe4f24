#include "map/life_cycle.h"

#include <algorithm>
#include <cmath>

namespace semantic_topo_loop::core {
namespace {

constexpr double kTransparentShare = 0.1;

}  // namespace

double landmark_quality(const MappedLandmark& landmark) {
  const Landmark& state = landmark.state;
  const double sigma = std::sqrt(std::max(0.0, state.center_covariance.trace() / 3.0));
  return state.mean_iou * (1.0 - std::exp(-state.baseline_deg / 15.0)) *
         (1.0 - std::exp(-landmark.sightings.seen_s / 0.7)) / (1.0 + sigma / 0.05);
}

LandmarkState life_cycle_state(const MappedLandmark& landmark, const QuadricMapperOptions& options, bool is_movable) {
  const Landmark& state = landmark.state;
  const Sightings& sightings = landmark.sightings;
  const double seen_share = sightings.seen_share();
  // What is hardly ever seen was never there; what was often seen and is no longer has gone. The second counts the
  // sightings missed since, so that an object that is seldom detected is given more time.
  // Where depth shows what lies behind it, it is not; unless that was so while it had boxes, too.
  if (sightings.transparent_s < kTransparentShare * sightings.seen_s &&
      sightings.seen_through_since_s > options.retire_seen_through_s) {
    return LandmarkState::kRetired;
  }
  if ((sightings.expected_s > options.retire_expected_s && seen_share < options.retire_seen_share) ||
      (is_movable && sightings.missed_since_s * sightings.familiar_share() > options.retire_missed_s)) {
    return LandmarkState::kRetired;
  }
  const bool confirmed =
      state.ellipsoid && state.observations >= options.min_views && sightings.whole_s >= options.confirm_seen_s &&
      state.baseline_deg >= options.confirm_baseline_deg && state.mean_iou >= options.confirm_mean_iou &&
      seen_share >= options.confirm_seen_share && landmark_quality(landmark) >= options.confirm_quality;
  return confirmed ? LandmarkState::kConfirmed : LandmarkState::kCandidate;
}

}  // namespace semantic_topo_loop::core
