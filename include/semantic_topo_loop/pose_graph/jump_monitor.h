#pragma once

#include <cstddef>
#include <deque>
#include <vector>

#include "semantic_topo_loop/pose_graph/odometry_edge.h"

namespace semantic_topo_loop::core {

/// Looks for bursts in which the odometry moves as no hand or robot does: a frame's motion is compared with the median
/// of the frames around it, and what exceeds the usual difference by far counts as a suspected jump of its edge.
class JumpMonitor {
 public:
  /// @param motion from the previous frame, dt_s > 0 ago   @param edge that the motion belongs to, not falling
  void add(const SE3& motion, double dt_s, std::size_t edge);
  /// Writes what is known by now into the edges; the last few frames have not been compared yet.
  void apply(std::vector<OdometryEdge>* edges) const;

 private:
  struct Motion {
    Vec6 rate;
    double dt_s = 0.0;
    std::size_t edge = 0;
  };
  void judge(std::size_t index);

  std::deque<Motion> window_;
  std::vector<Vec6> suspects_;  ///< one an edge: sum of what stood out
  std::vector<double> translations_,
      rotations_;  ///< how far the rates of the last frames differed from their surroundings
  std::size_t next_ = 0;
};

}  // namespace semantic_topo_loop::core
