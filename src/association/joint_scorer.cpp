#include <algorithm>

#include "association/levels.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kMemoryDecay = 1.8;  // of the last box's overlap for each second that missed the object
constexpr double kMemoryDecayMax = 0.36;
constexpr double kMemoryWeight = 0.9;  // of the last box against the projected quadric
constexpr double kMinSupport3d = 0.1;  // the quadric must agree at least so far with the last box
constexpr double kConfusableAgreement = 0.5;
constexpr double kHistogramShare = 0.1, kHistogramAgreement = 0.8;
constexpr double kOtherLabelOverlap = 0.5;  // a box of another label must overlap more
constexpr double kMatureObservations = 30.0, kMatureBonus = 0.15;

}  // namespace

double JointScorer::label_agreement(const Track& track, int class_id) const {
  if (track.class_id == class_id) return 1.0;
  const double base = classes_.confusable(track.class_id, class_id) ? kConfusableAgreement : 0.0;
  return track.class_share(class_id) > kHistogramShare ? std::max(base, kHistogramAgreement) : base;
}

double JointScorer::score(const AssociationContext& context, const TrackInFrame& candidate,
                          const PreparedDetection& detection) const {
  const Track& track = *candidate.track;
  const double iou_3d = candidate.projection ? iou(*candidate.projection, detection.visible) : 0.0;
  const double iou_2d = candidate.is_recent ? iou(track.last_box, detection.box) : 0.0;
  if (iou_2d == 0.0 && iou_3d == 0.0 && track.points_map.empty()) return 0.0;  // most pairs
  const double age_s = 1e-9 * static_cast<double>(context.frame->stamp_ns - track.last_stamp_ns);
  const double overlap_2d =
      iou_2d * (1.0 - std::clamp(kMemoryDecay * (age_s - context.interval_s), 0.0, kMemoryDecayMax));

  double overlap = overlap_2d, gate = options_.iou_joint_2d_min;
  if (track.is_provisional) {
    overlap = std::max(iou_3d, overlap_2d);
    gate = options_.iou_3d_min;
  } else if (track.has_ellipsoid) {
    overlap = std::max(iou_3d, iou_3d > kMinSupport3d ? kMemoryWeight * overlap_2d : 0.0);
    gate = options_.iou_3d_min;
  } else if (!track.points_map.empty() && label_agreement(track, detection.class_id) > 0.0) {
    const double share = share_of_points_in_box(track.points_map, context.P_image_map, detection.visible);
    if (share > options_.points_in_box_min) overlap = std::max(overlap, options_.iou_3d_min + gate * share);
  }
  if (overlap <= gate || (track.class_id != detection.class_id && overlap < kOtherLabelOverlap)) return 0.0;
  const double label = label_agreement(track, detection.class_id);
  if (label == 0.0) return 0.0;
  const double maturity = std::min(1.0, track.observations / kMatureObservations);
  return overlap * (0.5 + 0.5 * label) * (1.0 + kMatureBonus * maturity);
}

}  // namespace semantic_topo_loop::core
