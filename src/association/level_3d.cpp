#include "association/levels.h"

namespace semantic_topo_loop::core {

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

double Level3d::score(const AssociationContext& context, const TrackInFrame& candidate,
                      const PreparedDetection& detection) const {
  const Track& track = *candidate.track;
  if (track.class_id != detection.class_id ||
      track.last_keyframe_id < context.frame->keyframe_id - options_.window_keyframes) {
    return 0.0;
  }
  if (track.has_ellipsoid) {
    const double overlap = candidate.projection ? iou(*candidate.projection, detection.visible) : 0.0;
    return overlap > options_.iou_3d_min ? overlap : 0.0;
  }
  const double share = share_of_points_in_box(track.points_map, context.P_image_map, detection.visible);
  return share > options_.points_in_box_min ? share : 0.0;
}

}  // namespace semantic_topo_loop::core
