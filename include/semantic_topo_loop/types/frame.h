#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "semantic_topo_loop/types/camera.h"
#include "semantic_topo_loop/types/point_feature.h"

namespace semantic_topo_loop::core {

/// A point of the front end's map, as a keyframe sees it.
struct SparsePoint {
  std::int64_t id = -1;                                    ///< of the point, the same in every keyframe that sees it
  Eigen::Vector3f point_camera = Eigen::Vector3f::Zero();  ///< m
};

/// The points that a keyframe adds to the map. No image is kept.
struct KeyframePoints {
  std::vector<SparsePoint> sparse;          ///< in order of id
  std::vector<Eigen::Vector3f> semi_dense;  ///< on edges of the image, camera frame, m
};

/// A place of long ago that the odometry's source itself found again, as by points of its images.
struct SourceLoop {
  std::int64_t stamp_ns = 0;           ///< of the earlier image
  SE3 T_odom_camera;                   ///< of this image, had the odometry not drifted since the earlier one
  Mat6 covariance = Mat6::Identity();  ///< of that motion from the earlier image: (translation m, rotation rad), right
  int points = 0;                      ///< how many agree
};

/// A camera pose of the odometry at the stamp of an image.
struct PoseSample {
  std::int64_t stamp_ns = 0;
  SE3 T_odom_camera;
  std::optional<Mat6> covariance = {};  ///< as Frame's
  bool is_break = false;                ///< as stated by the source
  bool is_continuous = false;           ///< the source vouches for the motion, however long the previous sample is ago
  std::optional<SourceLoop> source_loop = {};
  std::shared_ptr<const std::vector<Vec3>> points_camera = {};  ///< camera frame, m
  std::shared_ptr<const std::vector<PointFeature>> features = {};
};

/// What the odometry says about one image. Immutable once built; every stage reads the same one.
struct Frame {
  std::int64_t frame_id = -1;  ///< counts the frames that have a pose, from 0, in time order
  std::int64_t stamp_ns = 0;
  std::int64_t keyframe_id = -1;  ///< the keyframe this frame hangs on: itself, or the last one before it
  bool is_keyframe = false;
  bool is_break = false;  ///< the odometry may have jumped between the previous frame and this one
  bool is_end = false;    ///< no image: the stream is over and every stage shall finish its work
  SE3 T_odom_camera;
  /// Stamp of the frame whose pose the ones between were given too: the odometry had stood, and has caught up now.
  std::optional<std::int64_t> held_since_ns;
  std::optional<Mat6> covariance;  ///< of the motion since the previous frame, in this camera's axes: (m, rad)
  std::optional<SourceLoop> source_loop;
  Camera camera;
  std::shared_ptr<const std::vector<Vec3>> points_camera;     ///< optional points seen by this frame, camera frame, m
  std::shared_ptr<const std::vector<PointFeature>> features;  ///< optional, of the front end's map, camera frame
  std::shared_ptr<const KeyframePoints> keyframe_points;  ///< optional, of keyframes: what the point map keeps of it
};

}  // namespace semantic_topo_loop::core
