#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/local_map.h"

namespace semantic_topo_loop::core {

/// Where up is, without a gravity sensor: a camera held without roll keeps its x axis level, so the direction that is
/// most nearly perpendicular to all x axes of the recent past is vertical; its sign is that of image-up. Uncertain
/// while the camera has hardly turned about the vertical, or rolls.
///
/// Where frames have points, the normals of the two largest surfaces of each vote, weighted by how often image-up is
/// near them: tables and floors agree over time and are seen from above, however the camera is rolled at times. What
/// they told last holds where nothing is clear.
class UpEstimator {
 public:
  explicit UpEstimator(double span_s);
  /// Starts afresh at a break of the odometry.
  void push(const Frame& frame);
  void clear();
  /// Up in the frame of a camera. Depends on relative poses only.
  UpDirection estimate(const Quaternion& q_odom_camera) const;
  /// How far a camera is rolled about its optical axis, clockwise as it sees, rad in [-pi, pi]; 0 if that is uncertain
  /// or the camera looks nearly straight up or down.
  double roll_rad(const Quaternion& q_odom_camera) const;

 private:
  struct Sample {
    std::int64_t stamp_ns;
    Quaternion q_odom_camera;
    std::vector<Vec3> normals_odom;  ///< of the largest surfaces, towards the camera
  };
  /// Of the samples, in which the camera is held nearly upright.
  double upright_share(const Vec3& up_odom) const;
  std::optional<Vec3> level_normal() const;

  std::int64_t span_ns_;
  std::deque<Sample> samples_;
  std::optional<Vec3> level_normal_odom_;  ///< the last that was clear
  bool is_clear_ = false;                  ///< it is of these samples
};

}  // namespace semantic_topo_loop::core
