#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "semantic_topo_loop/types/frame.h"

namespace semantic_topo_loop::core {

/// Where a frame was that had been given an earlier one's pose, once a later one has caught up: on the way between
/// them.
/// @param T_odom_camera as given   @return the same for a frame that is not between them
SE3 pose_on_the_way(std::int64_t stamp_ns, const SE3& T_odom_camera, const Frame& later);

/// Poses that are the last one again. An odometry slower than the images gives its last pose until it has a new one;
/// one that has lost track does so until it finds its way again, and may then know what it missed.
class HeldPoses {
 public:
  /// Call it once an image, in order.
  /// @return true if the pose is where the camera was: new ones usually come every few images, and none is overdue
  bool is_held(std::int64_t stamp_ns, const SE3& T_odom_camera);

  struct Motion {
    /// Stamp of the frame whose pose those before this one were given too, if the odometry has caught up since: a
    /// motion too sudden for one frame, and none for the time that it stood. nullopt if it did not stand, or goes on
    /// from there.
    std::optional<std::int64_t> caught_up_since_ns;
    bool is_way = false;  ///< no more than a camera does in the time since the pose before, which is not long ago
  };
  /// Call it once a frame, in order.   @return how the odometry came to its pose
  Motion move(std::int64_t stamp_ns, const SE3& T_odom_camera);
  /// The last motion was a break: how fast it was tells nothing of the camera, nor how long the odometry stood.
  void begin_anew();

 private:
  struct Speed {
    std::int64_t stamp_ns = 0;
    double translation_mps = 0.0, rotation_radps = 0.0;
  };
  struct Image {
    SE3 T_odom_camera;
    std::int64_t since_ns = 0;  ///< stamp of the first image with this pose
    std::size_t repeated = 0;   ///< images since then
  };
  std::optional<Image> image_;
  std::deque<std::size_t> repeated_;  ///< images that repeated a pose, of the last poses

  struct Pose {
    std::int64_t stamp_ns = 0;
    SE3 T_odom_camera;
    std::int64_t since_ns = 0;  ///< stamp of the first frame with this pose
  };
  std::optional<Pose> last_;
  std::deque<Speed> speeds_;  ///< of the last motions
};

}  // namespace semantic_topo_loop::core
