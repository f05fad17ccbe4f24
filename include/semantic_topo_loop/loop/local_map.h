#pragma once

#include <deque>
#include <optional>
#include <vector>

#include "semantic_topo_loop/loop/observation_window.h"
#include "semantic_topo_loop/loop/spheroid.h"
#include "semantic_topo_loop/loop/up_estimator.h"

namespace semantic_topo_loop::core {

struct LoopOptions;

/// A camera of a submap. The submap's frame is its anchor camera, so that the odometry's world never matters.
struct LocalFrame {
  std::int64_t frame_id = -1;
  Mat3 R_camera_local = Mat3::Identity();
  Vec3 t_camera_local = Vec3::Zero();
  Vec3 position = Vec3::Zero();  ///< of the camera, local frame, m
  Vec2 focal_px = Vec2::Ones();
  Box image;  ///< on the plane z = 1
  std::vector<ObservedBox> boxes;

  Vec3 to_camera(const Vec3& point) const { return R_camera_local * point + t_camera_local; }
};

/// A box that an object was fitted to.
struct SubmapView {
  int frame = -1;  ///< index in LocalMap::frames
  Box box;         ///< on the plane z = 1
};

struct LocalObject {
  std::int64_t landmark_id = -1;       ///< the one most of its boxes carry
  int label = -1;                      ///< of the class group
  int class_id = -1;                   ///< the one most of its boxes carry
  Spheroid spheroid;                   ///< about LocalMap::up, local frame
  Mat3 covariance = Mat3::Identity();  ///< of the centre, m^2
  int frames_seen = 0;
  double seen_share = 0.0;  ///< frames that detect it over frames that have it in view
  double parallax_deg = 0.0;
  std::vector<SubmapView> views;
};

/// Submap: the objects seen within a few seconds, placed by these frames alone.
struct LocalMap {
  std::int64_t keyframe_id = -1;  ///< the anchor, a keyframe near the middle
  std::int64_t frame_id = -1;
  std::int64_t stamp_ns = 0;
  std::int64_t begin_frame = -1, end_frame = -1;
  std::int64_t end_ns = 0;  ///< stamp of the last frame
  double span_s = 0.0;
  int segment = 0;                 ///< of the odometry, counted from break to break
  double drift_rad_s = 0.0;        ///< apparent drift of the odometry at the time
  bool is_earlier = false;         ///< of an earlier run, whose map is then what T_odom_anchor leads to
  SE3 T_odom_anchor;               ///< for the comparison with frames that follow, not with other submaps
  UpDirection up;                  ///< anchor camera frame
  std::vector<LocalFrame> frames;  ///< those that views or checks refer to
  std::vector<int> check_frames;   ///< indices of frames, spread evenly over the window
  std::vector<LocalObject> objects;
};

/// True if the point projects well inside the image, at a depth at which objects are mapped.
bool in_view(const LocalFrame& frame, const Vec3& point, double max_depth_m);

/// The submap in a unit of length of which `scale` make one of the old; boxes on the plane z = 1 do not depend on it.
LocalMap rescaled(LocalMap map, double scale);

class LocalMapBuilder {
 public:
  explicit LocalMapBuilder(const LoopOptions& options);
  /// @param T_odom of the frames, any world   @return nullopt if the window holds no keyframe
  std::optional<LocalMap> build(const std::deque<ObservedFrame>& window, const LandmarkRedirects& redirects,
                                const UpEstimator& up) const;

 private:
  std::vector<LocalObject> find_objects(const LocalMap& map, const LandmarkRedirects& redirects) const;
  std::optional<LocalObject> fit(const LocalMap& map, std::vector<SubmapView> views, const Vec3& center) const;

  int min_views_, fit_views_;
  double min_parallax_rad_, min_seen_share_, max_depth_m_, max_radius_m_;
};

}  // namespace semantic_topo_loop::core
