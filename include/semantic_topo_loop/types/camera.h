#pragma once

#include <array>

#include "semantic_topo_loop/types/box.h"
#include "semantic_topo_loop/types/result.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// Pinhole camera with plumb-bob distortion (k1, k2, p1, p2, k3), as in OpenCV and sensor_msgs/CameraInfo.
struct Camera {
  double fx = 0.0, fy = 0.0, cx = 0.0, cy = 0.0;  ///< px
  int width = 0, height = 0;                      ///< px
  std::array<double, 5> distortion{};

  /// @return an error that names field and value if no image can come from these values
  Status check() const;
  bool has_distortion() const;
  /// As self-calibration corrected it before: the other's focal lengths, if that differs by one factor of them at most;
  /// else as it is.
  Camera with_focal_lengths_of(const Camera& other) const;
  /// Pixel of the raw image to pixel of the undistorted image with the same intrinsics.
  Vec2 undistort(const Vec2& pixel) const;
  /// Inverse of undistort.
  Vec2 distort(const Vec2& pixel) const;
  /// Undistorts a detector's box by the middles of its four sides.
  Box undistort(const Box& box) const;
  /// The part of the undistorted image that the camera sees, by the middles of its four sides, and at least the raw
  /// image's rectangle; of a side where the lens model does not hold, the raw one's.
  Box image() const;
  /// Ray of an undistorted pixel in the camera frame, z = 1.
  Vec3 ray(const Vec2& pixel) const { return {(pixel.x() - cx) / fx, (pixel.y() - cy) / fy, 1.0}; }
  /// Undistorted pixel of a point before the camera, in the camera frame.
  Vec2 pixel(const Vec3& p) const { return {fx * p.x() / p.z() + cx, fy * p.y() / p.z() + cy}; }
  Mat3 intrinsics() const;
};

}  // namespace semantic_topo_loop::core
