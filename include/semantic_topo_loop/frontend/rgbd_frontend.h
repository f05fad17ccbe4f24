#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "semantic_topo_loop/frontend/frontend_options.h"
#include "semantic_topo_loop/frontend/rgbd_image.h"
#include "semantic_topo_loop/types/frame.h"

namespace semantic_topo_loop::core {

/// What became of one image.
enum class TrackingState {
  kStarted,      ///< the first image of an odometry: at the start, or anew after a loss (then the sample is a break)
  kTracked,      ///< followed from the image before
  kRelocalised,  ///< found again after a loss; a break if that was in an older part of the map
  kLost,         ///< no pose
  kUnusable,     ///< no pose: the image shows nothing to follow (too few features or depths)
};

struct TrackedImage {
  TrackingState state = TrackingState::kLost;
  std::optional<PoseSample> sample;  ///< neither of kLost nor of kUnusable
  int matches = 0;                   ///< map points found in the image
  int inliers = 0;                   ///< of these, how many the pose explains
  /// The calibration was corrected so early that it pays to begin anew: every pose until now has the old one's error.
  /// A correction found later begins a new map at the pose reached.
  bool is_recalibrated = false;
};

/// Visual odometry of an RGB-D camera: ORB features, projection into a local map, pose refinement, local bundle
/// adjustment with depth. Same images, same poses, bit for bit.
class RgbdFrontend {
 public:
  RgbdFrontend(const FrontendOptions& options, const Camera& camera);

  /// Images in time order, made by make_rgbd_image with the same camera.
  TrackedImage track(const RgbdImage& image);
  /// Forgets images, poses and points, but keeps what self-calibration found: for the first image again, or for the
  /// next recording of the same camera.
  void begin_anew();
  /// The color camera, with its focal lengths as self-calibration corrected them; else as given.
  const Camera& camera() const;
  /// What the last image with a pose adds to the map: the map points that it sees, with ids that this run uses once,
  /// and points on its edges.
  /// @param image that one   @param semi_dense_max about so many points on edges at most
  KeyframePoints keyframe_points(const RgbdImage& image, int semi_dense_max) const;

 private:
  struct Impl;
  std::unique_ptr<Impl, void (*)(Impl*)> impl_;
};

/// What became of the images of a run.
struct TrackingReport {
  std::int64_t images = 0;  ///< all of them
  std::int64_t tracked = 0;
  std::int64_t relocalised = 0;
  std::int64_t restarts = 0;    ///< odometries begun anew after a loss
  std::int64_t lost = 0;        ///< without a pose
  std::int64_t unusable = 0;    ///< without a pose, as there was nothing to follow
  std::int64_t unreadable = 0;  ///< missing, broken, of the wrong size or type
  std::string first_unreadable;

  void add(const TrackedImage& image);
  void add_unreadable(const std::string& problem);
  /// "3 of 58 images lost, ..."; empty if every image has a pose without a restart.
  std::string warning() const;
};

}  // namespace semantic_topo_loop::core
