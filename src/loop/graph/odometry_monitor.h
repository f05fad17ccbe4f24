#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include "loop/submap/observation_window.h"

namespace semantic_topo_loop::core {

/// Judges the odometry by the detections: the objects of the last submap should appear where the odometry puts them.
/// Their common shift in the image tells how fast the odometry drifts, and a sudden large one that it has jumped.
class OdometryMonitor {
 public:
  /// @param max_depth_m of objects that are looked for, as of submaps
  explicit OdometryMonitor(double max_depth_m) : max_depth_m_(max_depth_m) {}
  /// The submap that the next frames are compared with.
  void set_reference(const LocalMap& map);
  /// @return true if the odometry has jumped since the reference, which is then dropped
  bool push(const ObservedFrame& frame);
  /// Whether the objects stand where the odometry puts them, and would not if it were to be moved back by a jump.
  /// @param jump of the odometry before the frame: (m, rad), in its axes
  bool refutes(const Vec6& jump, const ObservedFrame& frame) const;
  /// Forgets the reference, at a break.
  void restart();
  /// Apparent drift, rad/s: the median of recent frames. It holds the noise of the boxes, so that it never is zero.
  /// @return nullopt while there are few frames to judge by
  std::optional<double> drift_rad_s() const;

 private:
  struct Node {
    int label;
    Vec3 center;  ///< odometry's world, m
    double radius;
  };
  struct Shift {
    Vec2 offset = Vec2::Zero();  ///< on the plane z = 1, detected - predicted
    int support = 0;             ///< objects that moved by it
    int in_place = 0;            ///< objects that are where they should be
  };

  Shift common_shift(const ObservedFrame& frame) const;

  double max_depth_m_;
  std::vector<Node> nodes_;
  std::int64_t reference_ns_ = 0;  ///< mean time of the reference's frames
  int jumped_frames_ = 0;
  std::deque<double> rates_;
};

}  // namespace semantic_topo_loop::core
