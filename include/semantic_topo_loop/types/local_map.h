#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "semantic_topo_loop/types/box.h"
#include "semantic_topo_loop/types/loop_closure.h"
#include "semantic_topo_loop/types/point_feature.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

struct UpDirection {
  Vec3 direction = Vec3(0.0, -1.0, 0.0);  ///< unit
  bool certain = false;                   ///< good enough to compare two places by it
};

/// An ellipsoid of revolution about a given axis: the shape of an object in a submap. A box says little more, and two
/// submaps that see an object from different sides agree on it (full ellipsoids brought nothing).
struct Spheroid {
  Vec3 center = Vec3::Zero();    ///< m
  Vec2 log_axes = Vec2::Zero();  ///< log of the semi-axes (across, along the axis), log m

  /// Of the sphere of the same volume, m.
  double radius() const { return std::exp((2.0 * log_axes(0) + log_axes(1)) / 3.0); }
};

/// A detection of a mappable class, as loop detection keeps it.
struct ObservedBox {
  std::int64_t landmark_id = -1;
  std::int64_t track_id = -1;  ///< of the object while it stays in view
  int label = -1;              ///< one number for all classes of a group
  int class_id = -1;           ///< of the track
  Box box;                     ///< on the plane z = 1 of the camera (undistorted, without intrinsics)
  std::uint8_t truncated = 0;  ///< Truncation bits
  double depth_m = 0.0;        ///< of the object's centre; 0 where the frame does not tell
};

/// A camera of a submap. The submap's frame is its anchor camera, so that the odometry's world never matters.
struct LocalFrame {
  std::int64_t frame_id = -1;
  Mat3 R_camera_local = Mat3::Identity();
  Vec3 t_camera_local = Vec3::Zero();
  Vec3 position = Vec3::Zero();  ///< of the camera, local frame, m
  Vec2 focal_px = Vec2::Ones();  ///< of the image made 640 pixels wide, if it is wider
  Box image;                     ///< on the plane z = 1
  std::vector<ObservedBox> boxes;

  Vec3 to_camera(const Vec3& point) const { return R_camera_local * point + t_camera_local; }
};

/// A box that an object was fitted to.
struct SubmapView {
  int frame = -1;              ///< index in LocalMap::frames
  Box box;                     ///< on the plane z = 1
  double depth_m = 0.0;        ///< of the object's centre; 0 where the frame does not tell
  std::uint8_t truncated = 0;  ///< Truncation bits: these sides bound nothing
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

/// A piece of a surface, some centimetres wide.
struct Surfel {
  Eigen::Vector3f position = Eigen::Vector3f::Zero();  ///< m
  Eigen::Vector3f normal = Eigen::Vector3f::UnitZ();   ///< unit, towards the cameras that saw it
};

/// Submap: the objects seen within a few seconds, placed by these frames alone.
struct LocalMap {
  std::int64_t keyframe_id = -1;  ///< the anchor, a keyframe near the middle
  std::int64_t frame_id = -1;
  std::int64_t stamp_ns = 0;
  std::int64_t begin_frame = -1, end_frame = -1;
  std::int64_t end_ns = 0;  ///< stamp of the last frame
  double span_s = 0.0;
  static constexpr int kOtherSession = -1;
  /// Of the odometry, counted from break to break; below 0: of another session, of whose map parts that no loop joins
  /// have other numbers.
  int segment = 0;
  /// What the odometry missed of the way to it while it stood, and what is not known of that: by so much more it may be
  /// off between two submaps of one segment. What it goes wrong by while it moves may be objects that look alike.
  struct Missed {
    double translation_m = 0.0, rotation_rad = 0.0;
  } missed;
  double drift_rad_s = 0.0;        ///< apparent drift of the odometry at the time
  bool is_earlier = false;         ///< of an earlier run, whose map is then what T_odom_anchor leads to
  SE3 T_odom_anchor;               ///< for the comparison with frames that follow, not with other submaps
  UpDirection up;                  ///< anchor camera frame
  std::vector<LocalFrame> frames;  ///< those that views or checks refer to
  std::vector<int> check_frames;   ///< indices of frames, spread evenly over the window
  std::vector<LocalObject> objects;
  std::shared_ptr<const std::vector<Surfel>> surfels;         ///< local frame; null if no frame came with points
  std::shared_ptr<const std::vector<PointFeature>> features;  ///< local frame; null if no frame came with any

  /// By the number that matching calls it by.
  const LocalObject& object(int i) const { return objects[static_cast<std::size_t>(i)]; }
};

/// What is new in a collection of submaps, and in what was found between them.
struct SubmapDelta {
  bool is_whole = true;                 ///< what is not in it is not kept
  std::vector<LocalMap> added;          ///< in order of frame_id
  std::vector<std::int64_t> forgotten;  ///< frame_ids
  std::vector<LoopFigures> decided;     ///< candidates that were refused, or are accepted and were refused before
  std::int64_t first_query = -1;        ///< the refused candidates of earlier query keyframes are forgotten
};

/// The submap in a unit of length of which `scale` make one of the old; boxes on the plane z = 1 do not depend on it.
/// Its surfels and features are left out: a camera that measures depth knows the unit.
inline LocalMap rescaled(LocalMap map, double scale) {
  for (LocalFrame& frame : map.frames) {
    frame.position *= scale;
    frame.t_camera_local *= scale;
  }
  for (LocalObject& object : map.objects) {
    object.spheroid.center *= scale;
    object.spheroid.log_axes.array() += std::log(scale);
    object.covariance *= scale * scale;
  }
  map.surfels.reset();
  map.features.reset();
  return map;
}

}  // namespace semantic_topo_loop::core
