#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/local_map.h"

namespace semantic_topo_loop::core {

/// Where up is, without a gravity sensor: a camera held without roll keeps its x axis level, so the direction that is
/// most nearly perpendicular to all x axes of the recent past is vertical; its sign is that of image-up. Uncertain
/// while the camera has hardly turned about the vertical, or rolls.
///
/// Where frames have points, the largest surface of each that may be level (its normal towards image-up, and as little
/// to the side as a camera without roll would see it) votes for its normal. Tables and floors agree over time, what
/// only looks level in some views does not: if most votes agree, their mean is up.
class UpEstimator {
 public:
  explicit UpEstimator(double span_s);
  /// Starts afresh at a break of the odometry.
  void push(const Frame& frame);
  void clear() { samples_.clear(); }
  /// Up in the frame of a camera. Depends on relative poses only.
  UpDirection estimate(const Quaternion& q_odom_camera) const;
  /// How far a camera is rolled about its optical axis, clockwise as it sees, rad in [-pi, pi]; 0 if that is uncertain
  /// or the camera looks nearly straight up or down.
  double roll_rad(const Quaternion& q_odom_camera) const;

 private:
  struct Sample {
    std::int64_t stamp_ns;
    Quaternion q_odom_camera;
    std::optional<Vec3> level_normal_odom;  ///< of the largest surface that may be level
  };
  std::optional<Vec3> level_normal(const Mat3& R_camera_odom) const;
  std::int64_t span_ns_;
  std::deque<Sample> samples_;
};

}  // namespace semantic_topo_loop::core
