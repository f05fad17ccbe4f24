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
  /// What stood out in a section, (m, rad); the last few frames have not been compared yet.
  Vec6 suspect(std::size_t section) const;

 private:
  struct Motion {
    Vec6 rate;
    double dt_s = 0.0;
    std::size_t section = 0;
  };
  void judge(std::size_t index);

  std::optional<StampedPose> last_;
  std::deque<Motion> window_;
  std::vector<Vec6> suspects_;  ///< by section
  /// How far the rates of the last frames differed from their surroundings.
  std::vector<double> translations_, rotations_;
  std::size_t next_ = 0;
};

}  // namespace semantic_topo_loop::core
