#pragma once

#include "frontend/image_tracker.h"

namespace semantic_topo_loop::core {

/// Decides which images the map is built from, and builds it.
class MapBuilder {
 public:
  MapBuilder(const FrontendOptions& options, const Camera& camera) : options_(options), camera_(camera) {}

  void set_camera(const Camera& camera) { camera_ = camera; }
  /// Whether the image shows enough that the map does not have.
  bool needs_keyframe(const TrackedFeatures& image, const TrackingMap& map) const;
  /// Adds the image as a keyframe, with new points from its depths, and tidies up around it.
  /// @return id of the keyframe
  std::int64_t add_keyframe(const TrackedFeatures& image, TrackingMap* map) const;

 private:
  void add_points(std::int64_t keyframe, TrackingMap* map) const;
  /// One point where two keyframes made two.
  void fuse(std::int64_t keyframe, TrackingMap* map) const;
  void fuse_into(const std::vector<std::int64_t>& points, std::int64_t keyframe, TrackingMap* map) const;
  void drop_points(std::int64_t newest, TrackingMap* map) const;
  void drop_keyframes(std::int64_t newest, TrackingMap* map) const;

  FrontendOptions options_;
  Camera camera_;
};

}  // namespace semantic_topo_loop::core
