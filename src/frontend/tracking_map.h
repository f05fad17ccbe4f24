#pragma once

#include <boost/container/flat_map.hpp>
#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <unordered_map>
#include <vector>

#include "frontend/image_features.h"
#include "frontend/nearest_depth.h"
#include "frontend/pose_solver.h"
#include "geometry/descriptor.h"
#include "geometry/word_index.h"
#include "semantic_topo_loop/frontend/frontend_options.h"
#include "semantic_topo_loop/types/frame.h"

namespace semantic_topo_loop::core {

/// A point of the map that images are tracked against.
struct MapPoint {
  std::int64_t id = -1;
  Vec3 position = Vec3::Zero();                         ///< map frame, m
  Descriptor descriptor{};                              ///< the one of its views that is most like the others
  Vec3 direction = Vec3::Zero();                        ///< mean of the unit vectors from the keyframes that see it
  double level_0_distance_m = 0.0;                      ///< from where it is seen on level 0 of the pyramid
  boost::container::flat_map<std::int64_t, int> views;  ///< keyframe to the index of its feature
  std::int64_t first_keyframe = -1;
  int expected = 1;  ///< images in which it should be seen
  int found = 1;     ///< images in which it was
};

/// A part of the map. How sections lie to each other is not known, or not well.
struct MapSection {
  int number = 0;
  int world = 0;  ///< sections of one followed each other without a loss: they lie together but for some centimetres
  bool operator==(const MapSection& other) const { return number == other.number; }
  bool operator!=(const MapSection& other) const { return !(*this == other); }
};

/// An image without its pixels.
struct FeatureImage {
  std::int64_t id = -1;
  std::int64_t stamp_ns = 0;
  SE3 T_camera_map;
  MapSection section;
  ImageFeatures features;
  std::vector<std::int64_t> points;  ///< of each feature; -1: none
  Vec3 center() const { return T_camera_map.inverse().t; }
};

/// One that the map is built from; its id counts keyframes.
struct TrackingKeyframe : FeatureImage {
  NearestDepth depth;
  SE3 T_odom_camera;  ///< as it was told
};

/// One on its way through the tracker; its id counts images.
struct TrackedFeatures : FeatureImage {
  Mat6 covariance = Mat6::Zero();  ///< of the pose, camera frame
  int matches = 0;
  int inliers = 0;
  std::vector<std::int64_t> expected;     ///< points that the last search around its first ones looked for
  std::optional<SourceLoop> source_loop;  ///< of the section that it was found in after a loss
};

/// Inliers that leave no doubt of a pose; with fewer, other ways to it are tried, and the map is built on.
inline int strong_inliers(const FrontendOptions& options) { return 3 * options.min_inliers; }

PoseObservation observation(const ImageFeature& feature, const MapPoint& point);

/// Keyframes and the points they see.
class TrackingMap {
 public:
  explicit TrackingMap(const FrontendOptions& options);
  const FrontendOptions& options() const { return options_; }

  TrackingKeyframe& add_keyframe(TrackingKeyframe keyframe);
  MapPoint& add_point(const Vec3& position, std::int64_t keyframe, int feature);
  void add_view(MapPoint* point, std::int64_t keyframe, int feature);
  void remove_view(std::int64_t point, std::int64_t keyframe);
  void remove_point(std::int64_t point);
  void remove_keyframe(std::int64_t keyframe);
  /// One point for two: `from` is removed, its views become those of `into`.
  void merge(std::int64_t from, std::int64_t into);
  /// Makes a section part of another one, which stays where it is. @param T_into_from of their coordinates
  void join(const MapSection& from, const MapSection& into, const SE3& T_into_from);
  /// Direction and distance, from its place and that of its views.
  void refresh_geometry(MapPoint* point) const;
  /// The descriptor as well, once the views are others.
  void refresh(MapPoint* point) const;

  /// @param id -1: none
  MapPoint* point(std::int64_t id);
  const MapPoint* point(std::int64_t id) const;
  TrackingKeyframe* keyframe(std::int64_t id);
  const std::map<std::int64_t, TrackingKeyframe>& keyframes() const { return keyframes_; }
  /// Of the next point that is made: ids count points.
  std::int64_t next_point() const { return next_point_; }
  /// In no order: they are looked up some ten thousand times an image.
  const std::unordered_map<std::int64_t, MapPoint>& points() const { return points_; }
  /// Keyframes that see points of this one, most first (the newer of two equal ones), with the number of points.
  std::vector<std::pair<std::int64_t, int>> covisible(std::int64_t keyframe) const;
  /// The same for a list of points (-1: none).
  std::vector<std::pair<std::int64_t, int>> covisible(const std::vector<std::int64_t>& points) const;
  /// How many visual words an image of these has in common with each keyframe, by id.
  std::vector<int> common_words(const std::vector<Descriptor>& descriptors) const {
    return words_.common(visual_words(descriptors));
  }
  /// Level of the pyramid on which a point is expected to be seen from a distance.
  int predict_level(const MapPoint& point, double distance_m) const;
  /// Size of its pixels on level 0. @param level up to kBeyond above the last one: what would be seen still larger is
  /// too near to look alike
  double scale_of(int level) const { return scales_[static_cast<std::size_t>(level)]; }
  static constexpr int kBeyond = 2;

 private:
  FrontendOptions options_;
  std::vector<double> scales_;  ///< of the levels
  std::map<std::int64_t, TrackingKeyframe> keyframes_;
  WordIndex words_;
  std::unordered_map<std::int64_t, MapPoint> points_;
  std::int64_t next_point_ = 0;
};

/// Counts for every point that the image should see whether it does.
void count_views(const TrackedFeatures& image, TrackingMap* map);
/// Whether the image shows enough that the map does not have.
bool needs_keyframe(const TrackedFeatures& image, const TrackingMap& map);
/// Adds the image as a keyframe, with new points from its depths, and tidies up around it. What stands where keyframes
/// before saw through has come by itself, and gives no points.
/// @param points_camera its depth image
/// @return id of the keyframe
std::int64_t add_keyframe(const TrackedFeatures& image, const std::vector<Vec3>& points_camera, const Camera& camera,
                          TrackingMap* map);

// Three ways to find an image's pose in the map (image_tracker.cpp).

/// Looks for the points of the last image where the guess puts them.
bool follow_points(const TrackedFeatures& last, const SE3& T_camera_map, const Camera& camera, TrackingMap* map,
                   TrackedFeatures* image);
/// Looks for the points of a keyframe without knowing where.
bool find_points(const TrackingKeyframe& keyframe, const Camera& camera, TrackingMap* map, TrackedFeatures* image);
/// Looks for all points around that should be in view, and fits the pose to all that were found.
/// @param apart_from of these keyframes, and of what is near but shares no points with the image, none are looked for
bool track_local_map(const Camera& camera, TrackingMap* map, TrackedFeatures* image,
                     const std::set<std::int64_t>* apart_from = nullptr);

}  // namespace semantic_topo_loop::core
