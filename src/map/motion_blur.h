#pragma once

#include <cmath>
#include <cstdint>
#include <optional>

#include "semantic_topo_loop/types/frame.h"

namespace semantic_topo_loop::core {

/// How many of the boxes that a detector finds in a sharp image it finds in one that the camera's motion has blurred.
/// Measured on fr1_xyz's images smeared along a line, with YOLOX-Nano (docs/algorithms.md): by 6, 10, 15 of 640 px
/// 0.74, 0.41 and 0.18 are left. Their edges are hardly worse.
class MotionBlur {
 public:
  /// Every frame, in order.
  void push(const Frame& frame) {
    constexpr double kStepMax_s = 0.2;  // over which a hand goes on alike
    const double step_s = stamp_ns_ && !frame.is_break ? 1e-9 * static_cast<double>(frame.stamp_ns - *stamp_ns_) : 0.0;
    is_known_ = step_s > 0.0 && step_s <= kStepMax_s;
    if (is_known_) {
      T_before_now_ = T_odom_camera_.inverse() * frame.T_odom_camera;
      limits_per_ray_ = kExposure_s / (step_s * kLimitOfWidth) * frame.camera.fx / frame.camera.width;
    }
    stamp_ns_ = frame.stamp_ns;
    T_odom_camera_ = frame.T_odom_camera;
  }

  /// That share in the last frame, of what is at a point of the camera frame, in [0, 1]; 1 where no frame before tells
  /// how the camera moves.
  double recall(const Vec3& point_camera) const {
    const Vec3 before = T_before_now_ * point_camera;
    if (!is_known_ || !(point_camera.z() > 0.0) || !(before.z() > 0.0)) return 1.0;
    const Vec2 moved = point_camera.head<2>() / point_camera.z() - before.head<2>() / before.z();
    return std::exp(-(limits_per_ray_ * moved).squaredNorm());
  }

 private:
  static constexpr double kExposure_s = 0.02;     ///< of a room by day or lamps; cameras seldom tell
  static constexpr double kLimitOfWidth = 0.017;  ///< blur at which e^-1 are left

  std::optional<std::int64_t> stamp_ns_;  ///< of the last frame
  SE3 T_odom_camera_;
  bool is_known_ = false;
  SE3 T_before_now_;
  double limits_per_ray_ = 0.0;  ///< blur, in that limit, of what moves by 1 on the plane z = 1 in a step
};

}  // namespace semantic_topo_loop::core
