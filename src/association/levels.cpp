#include "association/levels.h"

#include <algorithm>
#include <cmath>

#include "geometry/wide_image.h"

namespace semantic_topo_loop::core {
namespace {

// Level 2's model of a box, which Mu et al. leave open; the values with which the cascade was measured on fr2_desk and
// fr3_office.
constexpr double kCenterSigmaShare = 0.3;  // of the box size
constexpr double kCenterSigmaFloor_px = 4.0;
constexpr double kLogSizeSigma = 0.35;    // of each side: a factor of 1.4
constexpr double kLogSizeRange = 3.0;     // a new object's sides lie anywhere in a range of 1 to e^3 = 20
constexpr double kClassSmoothing = 0.05;  // pseudo-count of every class: an unheard label is unlikely, not impossible

/// log p(z|i): Gaussian in the box centre and in the logarithms of its sides.
double log_likelihood(const Box& predicted, const Box& box, double center_floor_px) {
  const double variance = std::pow(kCenterSigmaShare * predicted.size(), 2) + center_floor_px * center_floor_px;
  const Vec2 log_sides(std::log(std::max(1.0, box.width()) / std::max(1.0, predicted.width())),
                       std::log(std::max(1.0, box.height()) / std::max(1.0, predicted.height())));
  const double size_variance = kLogSizeSigma * kLogSizeSigma;
  return -0.5 *
             ((box.center() - predicted.center()).squaredNorm() / variance + log_sides.squaredNorm() / size_variance) -
         std::log(2.0 * kPi * variance) - std::log(2.0 * kPi * size_variance);
}

/// Share of the points (map frame, m) that project into the box.
double share_of_points_in_box(const std::vector<Vec3>& points_map, const Mat34& P_image_map, const Box& box) {
  if (points_map.empty()) return 0.0;
  std::size_t inside = 0;
  for (const Vec3& point : points_map) {
    const Vec3 p = P_image_map.leftCols<3>() * point + P_image_map.col(3);
    if (!(p.z() > 0.0)) continue;
    const Vec2 pixel = p.head<2>() / p.z();
    if (pixel.x() >= box.x1 && pixel.x() <= box.x2 && pixel.y() >= box.y1 && pixel.y() <= box.y2) ++inside;
  }
  return static_cast<double>(inside) / static_cast<double>(points_map.size());
}

bool is_in_previous_frame(const AssociationContext& context, const Track& track) {
  return track.last_answer == context.answer - 1 && track.last_answer >= context.first_answer;
}

constexpr double kReachFloor_m = 0.15;  // of depth's place of an object about the centre of its landmark, for a thing
constexpr double kReachShare = 0.5;     // of no size, and what half a thing adds: of a box that is cut there is a half
constexpr double kInside = 0.7;         // of the smaller box: more than neighbours in a row hide of each other

bool is_same_thing(const Track& track, const PreparedDetection& detection) {
  return track.has_ellipsoid &&
         std::any_of(detection.placements.begin(), detection.placements.end(), [&track](const Placement& placement) {
           return is_one_thing(placement, {track.center_map, track.size_m});
         });
}

double iou_3d(const TrackInFrame& candidate, const PreparedDetection& detection) {
  return candidate.projection ? iou(*candidate.projection, detection.visible) : 0.0;
}

/// How well a label speaks for a track, in [0, 1].
double label_agreement(const AssociationContext& context, const Track& track, int class_id) {
  if (track.class_id == class_id) return 1.0;
  const AssociatorOptions& options = context.options;
  const double base = context.classes.confusable(track.class_id, class_id) ? options.label_agreement_confusable : 0.0;
  return track.class_share(class_id) > options.label_history_min_share ? std::max(base, options.label_agreement_history)
                                                                       : base;
}

}  // namespace

NearestPlacement nearest_placement(const Track& track, const PreparedDetection& detection) {
  NearestPlacement nearest;
  for (const Placement& placement : detection.placements) {
    const double reach_m = kReachFloor_m + kReachShare * std::max(track.size_m, placement.size_m);
    const double closeness = 1.0 - (placement.center - track.center_map).norm() / reach_m;
    if (closeness > nearest.closeness) nearest = {closeness, &placement};
  }
  return nearest;
}

bool show_one_thing(const PreparedDetection& a, const PreparedDetection& b) {
  const auto is_also_b = [&b](const Placement& of_a) {
    return std::any_of(b.placements.begin(), b.placements.end(),
                       [&of_a](const Placement& of_b) { return is_one_thing(of_a, of_b); });
  };
  return std::any_of(a.placements.begin(), a.placements.end(), is_also_b) &&
         intersection_area(a.visible, b.visible) > kInside * std::min(a.visible.area(), b.visible.area());
}

double score_2d(const AssociationContext& context, const TrackInFrame& candidate, const PreparedDetection& detection) {
  const Track& track = *candidate.track;
  if (!is_in_previous_frame(context, track) || track.class_id != detection.class_id) return 0.0;
  const double overlap = iou(track.last_box, detection.box);
  return overlap > context.options.iou_2d_min ? overlap : 0.0;
}

double score_posterior(const AssociationContext& context, const TrackInFrame& candidate,
                       const PreparedDetection& detection) {
  const Track& track = *candidate.track;
  if (!is_in_previous_frame(context, track)) return 0.0;
  const AssociatorOptions& options = context.options;
  const auto class_count = static_cast<double>(std::max<std::size_t>(1, context.classes.classes().size()));
  const Box& predicted = candidate.projection ? *candidate.projection : track.last_box;
  // Uncapped, a landmark seen a thousand times would swallow its neighbours.
  const double n = std::min(static_cast<double>(track.observations), options.posterior_count_max);
  const double label =
      (n * track.class_share(detection.class_id) + kClassSmoothing) / (n + class_count * kClassSmoothing);
  const double center_floor_px = kCenterSigmaFloor_px * pixel_factor(context.frame->camera);
  const double existing = std::log(n) + std::log(label) + log_likelihood(predicted, detection.box, center_floor_px);
  double fresh = std::log(options.posterior_alpha);
  if (options.pro_new_object == "uniform") {
    const double image_area = static_cast<double>(context.frame->camera.width) * context.frame->camera.height;
    fresh -= std::log(class_count) + std::log(image_area) + 2.0 * std::log(kLogSizeRange);
  }
  return existing > fresh ? 1.0 + existing - fresh : 0.0;
}

double score_3d(const AssociationContext& context, const TrackInFrame& candidate, const PreparedDetection& detection) {
  const Track& track = *candidate.track;
  const AssociatorOptions& options = context.options;
  if (track.class_id != detection.class_id ||
      track.last_keyframe_id < context.frame->keyframe_id - options.window_keyframes) {
    return 0.0;
  }
  if (track.has_ellipsoid) {
    const double overlap = iou_3d(candidate, detection);
    return overlap > options.iou_3d_min ? overlap : 0.0;
  }
  const double share = share_of_points_in_box(track.points_map, context.P_image_map, detection.visible);
  return share > options.points_in_box_min ? share : 0.0;
}

double score_joint(const AssociationContext& context, const TrackInFrame& candidate,
                   const PreparedDetection& detection) {
  const Track& track = *candidate.track;
  const AssociatorOptions& options = context.options;
  const double overlap_3d = iou_3d(candidate, detection);
  const double iou_2d = candidate.is_recent ? iou(track.last_box, detection.box) : 0.0;
  if (iou_2d == 0.0 && overlap_3d == 0.0 && track.points_map.empty() && detection.placements.empty())
    return 0.0;  // most pairs
  const double age_s = 1e-9 * static_cast<double>(context.frame->stamp_ns - track.last_stamp_ns);
  const double decay =
      std::clamp(options.memory_decay_per_s * (age_s - context.interval_s), 0.0, options.memory_decay_max);
  const double overlap_2d = iou_2d * (1.0 - decay);

  double overlap = overlap_2d, gate = options.iou_joint_2d_min;
  if (track.is_provisional) {
    overlap = std::max(overlap_3d, overlap_2d);
    gate = options.iou_3d_min;
  } else if (track.has_ellipsoid) {
    overlap = std::max(overlap_3d, overlap_3d > options.memory_iou_3d_min ? options.memory_weight * overlap_2d : 0.0);
    gate = options.iou_3d_min;
  } else if (!track.points_map.empty() && label_agreement(context, track, detection.class_id) > 0.0) {
    const double share = share_of_points_in_box(track.points_map, context.P_image_map, detection.visible);
    if (share > options.points_in_box_min) overlap = std::max(overlap, options.iou_3d_min + gate * share);
  }
  if (track.has_ellipsoid && !detection.placements.empty()) {
    const NearestPlacement nearest = nearest_placement(track, detection);
    if (nearest.placement == nullptr) return 0.0;
    overlap = std::max(overlap, nearest.closeness);
  }
  if (overlap <= gate || (track.class_id != detection.class_id && overlap < options.iou_other_label_min)) return 0.0;
  double label = label_agreement(context, track, detection.class_id);
  if (is_same_thing(track, detection)) label = std::max(label, options.label_agreement_place);
  if (label == 0.0) return 0.0;
  const double maturity = std::min(1.0, static_cast<double>(track.observations) / options.mature_observations);
  return overlap * (0.5 + 0.5 * label) * (1.0 + options.mature_bonus * maturity);
}

double score_jda(const AssociationContext& context, const TrackInFrame& candidate, const PreparedDetection& detection) {
  const Track& track = *candidate.track;
  const double distance_2d = is_in_previous_frame(context, track) ? 1.0 - iou(track.last_box, detection.box) : 1.0;
  const double distance_3d = candidate.projection ? 1.0 - iou(*candidate.projection, detection.visible) : 1.0;
  const double distance_label = track.class_id == detection.class_id ? 0.0 : 1.0;
  return context.options.jda_distance_max - (distance_2d + distance_3d + distance_label);
}

}  // namespace semantic_topo_loop::core
