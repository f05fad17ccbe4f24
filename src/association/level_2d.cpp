#include "association/levels.h"

namespace semantic_topo_loop::core {

double Level2d::score(const AssociationContext& context, const TrackInFrame& candidate,
                      const PreparedDetection& detection) const {
  const Track& track = *candidate.track;
  if (track.last_frame_id != context.frame->frame_id - 1 || track.class_id != detection.class_id) return 0.0;
  const double overlap = iou(track.last_box, detection.box);
  return overlap > iou_min_ ? overlap : 0.0;
}

}  // namespace semantic_topo_loop::core
