#include <cmath>

#include "association/levels.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kCenterSigmaShare = 0.3;  // of the box size
constexpr double kCenterSigmaFloorPx = 4.0;
constexpr double kLogSizeSigma = 0.35;
constexpr double kLogSizeRange = 3.0;     // width of the prior on each log side
constexpr double kClassSmoothing = 0.05;  // pseudo-count of every class

/// log p(z|i): Gaussian in the box centre and in the logarithms of its sides.
double log_likelihood(const Box& predicted, const Box& box) {
  const double variance = std::pow(kCenterSigmaShare * predicted.size(), 2) + kCenterSigmaFloorPx * kCenterSigmaFloorPx;
  const Vec2 log_sides(std::log(std::max(1.0, box.width()) / std::max(1.0, predicted.width())),
                       std::log(std::max(1.0, box.height()) / std::max(1.0, predicted.height())));
  const double size_variance = kLogSizeSigma * kLogSizeSigma;
  return -0.5 *
             ((box.center() - predicted.center()).squaredNorm() / variance + log_sides.squaredNorm() / size_variance) -
         std::log(2.0 * kPi * variance) - std::log(2.0 * kPi * size_variance);
}

}  // namespace

double LevelPosterior::score(const AssociationContext& context, const TrackInFrame& candidate,
                             const PreparedDetection& detection) const {
  const Track& track = *candidate.track;
  if (track.last_frame_id != context.frame->frame_id - 1) return 0.0;
  const Box& predicted = candidate.projection ? *candidate.projection : track.last_box;
  // Uncapped, a landmark seen a thousand times would swallow its neighbours.
  const double n = std::min<double>(track.observations, options_.posterior_count_max);
  const double label =
      (n * track.class_share(detection.class_id) + kClassSmoothing) / (n + class_count_ * kClassSmoothing);
  const double existing = std::log(n) + std::log(label) + log_likelihood(predicted, detection.box);
  double fresh = std::log(options_.posterior_alpha);
  if (options_.pro_new_object == "uniform") {
    const double image_area = static_cast<double>(context.frame->camera.width) * context.frame->camera.height;
    fresh -= std::log(class_count_) + std::log(image_area) + 2.0 * std::log(kLogSizeRange);
  }
  return existing > fresh ? 1.0 + existing - fresh : 0.0;
}

}  // namespace semantic_topo_loop::core
