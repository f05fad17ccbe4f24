#include "association/levels.h"

namespace semantic_topo_loop::core {

double JdaScorer::score(const AssociationContext& context, const TrackInFrame& candidate,
                        const PreparedDetection& detection) const {
  const Track& track = *candidate.track;
  const bool in_previous_frame = track.last_frame_id == context.frame->frame_id - 1;
  const double distance_2d = in_previous_frame ? 1.0 - iou(track.last_box, detection.box) : 1.0;
  const double distance_3d = candidate.projection ? 1.0 - iou(*candidate.projection, detection.visible) : 1.0;
  const double distance_label = track.class_id == detection.class_id ? 0.0 : 1.0;
  return distance_max_ - (distance_2d + distance_3d + distance_label);
}

}  // namespace semantic_topo_loop::core
