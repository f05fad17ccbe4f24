#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <opencv2/core.hpp>
#include <vector>

#include "semantic_topo_loop/frontend/rgbd_image.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// A room of 4 x 3 x 5 m seen from inside, its walls covered with patches of random brightness.
class SyntheticRoom {
 public:
  explicit SyntheticRoom(const Camera& camera) : camera_(camera) {}

  static Camera small_camera() { return {270.0, 270.0, 159.5, 119.5, 320, 240, {}}; }

  /// What the camera sees: brightness of the middle of four quarters of each pixel, depth of its own middle.
  RgbdImage render(std::int64_t stamp_ns, const SE3& T_world_camera) const {
    RgbdImage image;
    image.stamp_ns = stamp_ns;
    image.gray.create(camera_.height, camera_.width, CV_8UC1);
    image.depth_m.create(camera_.height, camera_.width, CV_32FC1);
    const Mat3 R = T_world_camera.rotation();
    for (int v = 0; v < camera_.height; ++v) {
      for (int u = 0; u < camera_.width; ++u) {
        double sum = 0.0, z = 0.0;
        for (const auto& [du, dv] :
             {std::pair(-0.25, -0.25), std::pair(0.25, -0.25), std::pair(-0.25, 0.25), std::pair(0.25, 0.25)}) {
          const Vec3 ray = R * camera_.ray(camera_.undistort(Vec2(u + du, v + dv)));
          const double range = hit(T_world_camera.t, ray);
          sum += brightness(T_world_camera.t + range * ray);
          z += range;
        }
        image.gray.at<std::uint8_t>(v, u) = static_cast<std::uint8_t>(std::lround(sum / 4.0));
        image.depth_m.at<float>(v, u) = static_cast<float>(z / 4.0);
      }
    }
    return image;
  }

 private:
  /// Factor of the ray at which it meets a wall.
  static double hit(const Vec3& origin, const Vec3& ray) {
    const Vec3 half(2.0, 1.5, 2.5);
    double nearest = 1e9;
    for (int axis = 0; axis < 3; ++axis) {
      if (ray[axis] == 0.0) continue;
      nearest = std::min(nearest, ((ray[axis] > 0.0 ? half[axis] : -half[axis]) - origin[axis]) / ray[axis]);
    }
    return nearest;
  }
  /// Sum of patches of three sizes.
  static double brightness(const Vec3& p) {
    double value = 128.0;
    for (const auto& [size_m, contrast] : {std::pair(0.31, 50.0), std::pair(0.13, 40.0), std::pair(0.05, 30.0)}) {
      // Off the walls' own planes, on which the cell would hang on rounding.
      const auto cell = [size = size_m](double x) {
        return static_cast<std::uint64_t>(static_cast<std::int64_t>(std::floor((x + 0.017) / size)));
      };
      std::uint64_t hash = 1469598103934665603ULL;
      for (const std::uint64_t part : {cell(p.x()), cell(p.y()), cell(p.z())}) {
        hash = (hash ^ part) * 1099511628211ULL;
        hash ^= hash >> 29;
      }
      value += contrast * (static_cast<double>(hash % 1001) / 500.0 - 1.0);
    }
    return std::clamp(value, 0.0, 255.0);
  }

  Camera camera_;
};

/// A swaying walk, 30 images a second.
inline SE3 pose_on_walk(double time_s) {
  const Quaternion q =
      so3_exp(Vec3(0.08 * std::sin(1.3 * time_s), 0.35 * std::sin(0.9 * time_s), 0.05 * std::sin(time_s)));
  return {q, Vec3(0.4 * std::sin(0.9 * time_s), 0.15 * std::sin(1.7 * time_s), -0.8 + 0.3 * std::cos(0.7 * time_s))};
}

inline std::int64_t stamp_of(int image) { return 1000000000LL + image * 33333333LL; }

}  // namespace semantic_topo_loop::core
