#pragma once

#include <cstddef>
#include <deque>
#include <vector>

#include "semantic_topo_loop/geometry/se3.h"

namespace semantic_topo_loop::core {

/// Looks for bursts in which an odometry moves as no hand or robot does: a frame's motion is compared with the median
/// of the frames around it, and what exceeds the usual difference by far counts as a suspected jump of its section.
class MotionBursts {
 public:
  /// @param motion from the previous frame, dt_s > 0 ago   @param section of the path that it belongs to, not falling
  void add(const SE3& motion, double dt_s, std::size_t section);
  /// What stood out in a section, (m, rad); the last few frames have not been compared yet.
  Vec6 suspect(std::size_t section) const;

 private:
  struct Motion {
    Vec6 rate;
    double dt_s = 0.0;
    std::size_t section = 0;
  };
  void judge(std::size_t index);

  std::deque<Motion> window_;
  std::vector<Vec6> suspects_;  ///< by section
  /// How far the rates of the last frames differed from their surroundings.
  std::vector<double> translations_, rotations_;
  std::size_t next_ = 0;
};

}  // namespace semantic_topo_loop::core
