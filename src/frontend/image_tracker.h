#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "frontend/tracking_map.h"

namespace semantic_topo_loop::core {

/// Finds an image's pose in the map.
class ImageTracker {
 public:
  /// @param camera must outlive this; may be corrected meanwhile
  ImageTracker(const FrontendOptions& options, const Camera& camera) : options_(options), camera_(camera) {}

  /// Looks for the points of the last image where the guess puts them.
  bool follow(const TrackedFeatures& last, const SE3& T_camera_map, TrackingMap* map, TrackedFeatures* image) const;
  /// Looks for the points of a keyframe without knowing where.
  bool find(const TrackingKeyframe& keyframe, TrackingMap* map, TrackedFeatures* image) const;
  /// Looks for all points around that should be in view, and fits the pose to all that were found.
  bool track_local_map(TrackingMap* map, TrackedFeatures* image) const;

 private:
  /// Fits the pose from `T_camera_map`; features that do not agree lose their point.
  bool fit(const SE3& T_camera_map, TrackingMap* map, TrackedFeatures* image) const;
  /// Looks for points in view that the image has not been matched with.
  void match_points(const std::vector<MapPoint*>& points, const TrackingMap& map, TrackedFeatures* image) const;
  std::vector<std::int64_t> local_keyframes(const TrackingMap& map, const TrackedFeatures& image) const;
  /// Where a point should be seen; nullopt if it is out of view.
  std::optional<SearchItem> expect(const TrackingMap& map, const MapPoint& point, const SE3& T_camera_map) const;

  FrontendOptions options_;
  const Camera& camera_;
};

}  // namespace semantic_topo_loop::core
