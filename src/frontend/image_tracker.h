#pragma once

#include "frontend/tracking_map.h"

namespace semantic_topo_loop::core {

// Three ways to find an image's pose in the map.

/// Looks for the points of the last image where the guess puts them.
bool follow_points(const TrackedFeatures& last, const SE3& T_camera_map, const Camera& camera, TrackingMap* map,
                   TrackedFeatures* image);
/// Looks for the points of a keyframe without knowing where.
bool find_points(const TrackingKeyframe& keyframe, const Camera& camera, TrackingMap* map, TrackedFeatures* image);
/// Looks for all points around that should be in view, and fits the pose to all that were found.
bool track_local_map(const Camera& camera, TrackingMap* map, TrackedFeatures* image);

}  // namespace semantic_topo_loop::core
