#pragma once

#include <cstddef>
#include <deque>
#include <optional>
#include <vector>

#include "semantic_topo_loop/geometry/stamped_pose.h"

namespace semantic_topo_loop::core {

/// Looks for bursts in which an odometry moves as no hand or robot does: a frame's motion is compared with the median
/// of the frames around it, and what exceeds the usual difference by far counts as a suspected jump of its section.
class MotionBursts {
 public:
  /// Takes in the next pose of the odometry; the motion to a pose after a break, or one that is not later, is left out.
  /// @param section of the path that the motion belongs to, not falling
  void push(const StampedPose& pose, bool is_break, std::size_t section);
  /// What stood out in a section: by so much the odometry may have jumped.
  struct Suspect {
    Vec6 motion = Vec6::Zero();  ///< (m, rad), in the axes of the odometry
    /// How far the motion usually is from that of the frames around, over as long a time: so far the jump, if it was
    /// one, may be off what stood out.
    double error_m = 0.0, error_rad = 0.0;
  };
  /// The last few frames have not been compared yet.
  Suspect suspect(std::size_t section) const;

 private:
  struct Motion {
    Vec6 rate;
    Quaternion q_odom_camera;
    double dt_s = 0.0;
    std::size_t section = 0;
  };
  void judge(std::size_t index);

  std::optional<StampedPose> last_;
  std::deque<Motion> window_;
  std::vector<Suspect> suspects_;  ///< by section
  /// How far the rates of the last frames differed from their surroundings.
  std::vector<double> translations_, rotations_;
  std::size_t next_ = 0;
};

}  // namespace semantic_topo_loop::core
