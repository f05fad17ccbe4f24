#pragma once

#include <optional>

#include "semantic_topo_loop/types/frame.h"

namespace semantic_topo_loop::core {

/// The odometry between two consecutive keyframes.
struct OdometryEdge {
  SE3 T_from_to;
  double path_m = 0.0;             ///< length of the camera's path, frame by frame
  double rotation_rad = 0.0;       ///< sum of the rotation angles, frame by frame
  std::optional<Mat6> covariance;  ///< stated by the source: (translation m, rotation rad), right
  bool is_break = false;           ///< nothing is known about this motion
  /// Motion that stands out of that before and after, see MotionBursts: the odometry may have jumped by it, or not at
  /// all (translation m, rotation rad; right).
  Vec6 suspect = Vec6::Zero();
  double suspect_error_m = 0.0, suspect_error_rad = 0.0;  ///< sigma of what a jump was more or less
};

/// Noise of an odometry whose source states none: a random walk, and errors that last.
struct OdometryNoise {
  double translation_m = 0.001;      ///< sigma after a path of one metre, grows with the root of the path
  double rotation_rad = 0.00035;     ///< sigma after a rotation of one radian, grows with the root of the rotation
  double steady_translation = 0.0;   ///< sigma of the slowly varying drift, metres a metre of path
  double steady_rotation_rad = 0.0;  ///< the same of the rotation, radians a metre of path
  double scale = 0.0;                ///< sigma of a constant scale error
  /// Root of twice the probability that a suspected jump is one: 0 never, 1 where each is as likely as not.
  double suspicion = 1.0;
};

/// What a standing camera's edge keeps, so that its information stays finite.
constexpr double kMinEdgeTranslation_m = 2e-4;
constexpr double kMinEdgeRotation_rad = 1e-4;

/// What the odometry is expected to be off at suspected jumps: the measurement is the motion, and this behind it.
Vec6 expected_jump(const OdometryEdge& edge, const OdometryNoise& noise);
/// Covariance of an edge: the source's, or the noise model's, or next to no knowledge at a break.
Mat6 odometry_covariance(const OdometryEdge& edge, const OdometryNoise& noise);

/// Collects frames between two keyframes into an edge.
class OdometryAccumulator {
 public:
  /// Adds the motion from the previous frame. Call it once for every frame, in order.
  void add(const Frame& frame);
  /// The edge from the last keyframe to this one; the next edge starts here.
  OdometryEdge finish(const SE3& T_odom_from, const SE3& T_odom_to);

 private:
  std::optional<SE3> T_odom_previous_;
  OdometryEdge edge_;
  bool all_stated_ = true;
  Mat6 covariance_ = Mat6::Zero();
};

}  // namespace semantic_topo_loop::core
