#pragma once

#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "odometry/graph_loop.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/solved_motion.h"

namespace semantic_topo_loop::core {

// How good is this odometry, and where did it break? As things are:
//   1. OdometryAccumulator makes an edge of the frames between two keyframes, with the breaks and the covariances that
//      the source states;
//      what the loop detector solved for with the objects in view takes the place of the odometry's motion there, with
//      the freezes that it found (SolvedMotion);
//   2. MotionBursts (motion_bursts.h) suspects jumps in the motion alone; the loop detector asks BurstWatch;
//   3. PathNoise asks of one loop how noisy the odometry would have to be to explain it, see Innovation;
//   4. ShortTermNoiseEstimator (short_term_noise.h) and OdometryDelay (odometry_delay.h) learn from the windows that
//      the loop detector solves how far the odometry is off over seconds, and how late it is;
//   5. InnovationModel and estimate_noise_and_jumps (noise_estimator.h) learn the noise from all loops that are
//      believed, and find the jumps that the motion does not show.
// A loop is a measurement of the odometry between its ends, which is why GraphLoop (graph_loop.h) stands here and not
// in the pose graph above.

/// Covariance of an edge by its causes.
struct EdgeCovariance {
  Mat6 given = Mat6::Zero();            ///< whatever the noise is
  Mat6 translation = Mat6::Zero();      ///< times the square of OdometryNoise::translation_m
  Mat6 rotation = Mat6::Zero();         ///< times the square of rotation_rad
  Mat6 suspected_jumps = Mat6::Zero();  ///< times the square of jump_prior

  EdgeCovariance& operator+=(const EdgeCovariance& other);
  /// J m J^T of each.
  EdgeCovariance carried(const Mat6& J) const;
};

/// The odometry between two keyframes, consecutive ones unless several edges were joined.
struct OdometryEdge {
  SE3 T_from_to;
  double path_m = 0.0;             ///< length of the camera's path
  double rotation_rad = 0.0;       ///< sum of the rotation angles along it
  std::optional<Mat6> covariance;  ///< stated by the source, or settled: (translation m, rotation rad), right
  bool is_break = false;           ///< nothing is known about this motion
  MissedMotion missed;
  /// Motion that stands out of that before and after, see MotionBursts: the odometry may have jumped by it, or not at
  /// all (translation m, rotation rad; right).
  Vec6 suspected_jump = Vec6::Zero();
  double jump_error_m = 0.0, jump_error_rad = 0.0;  ///< sigma of what a jump was more or less
  /// Of a joined edge, unless the source states all of it: what a turn on the way does to its end is not in the figures
  /// above.
  std::shared_ptr<const EdgeCovariance> joined;
  /// The motion as the odometry had it, if a solved one stands above.
  std::shared_ptr<const OdometryEdge> measured;

  /// Whether the edge is as uncertain as the odometry's noise has it.
  bool is_modelled() const { return !covariance && !is_break; }
  /// Takes over a solved motion between the same keyframes, unless that has figures that no motion has, or this one is
  /// a break, joined, or of a source that states how good it is.
  /// @return whether it did
  bool refine(const SolvedMotion& motion);
  /// Becomes what was found out about it in the end: no noise that is learnt later changes it.
  /// @param error of it
  void settle(const SE3& T, const Mat6& error);
};

/// Noise of an odometry whose source states none: a random walk, and errors that last.
struct OdometryNoise {
  double translation_m = 0.001;      ///< sigma after a path of one metre, grows with the root of the path
  double rotation_rad = 0.00035;     ///< sigma after a rotation of one radian, grows with the root of the rotation
  double steady_translation = 0.0;   ///< sigma of the slowly varying drift, metres a metre of path
  double steady_rotation_rad = 0.0;  ///< the same of the rotation, radians a metre of path
  double scale = 0.0;                ///< sigma of a constant scale error
  /// Prior of suspected jumps, the root of twice the probability that one is real: 0 never, 1 as likely as not.
  double jump_prior = 1.0;
};
/// Leaves of an edge's covariance what does not hang on the noise.
inline constexpr OdometryNoise kNoNoise{0.0, 0.0, 0.0, 0.0, 0.0, 0.0};

/// Covariance of (translation, rotation) without correlations, the same on all axes. @param ..._variance m^2, rad^2
Mat6 isotropic_covariance(double translation_variance, double rotation_variance);
/// What the odometry is expected to be off at suspected jumps: the measurement is the motion, and this behind it.
Vec6 expected_jump(const OdometryEdge& edge, const OdometryNoise& noise);
/// Covariance of an edge: the source's, or the noise model's, or next to no knowledge at a break.
Mat6 odometry_covariance(const OdometryEdge& edge, const OdometryNoise& noise);

/// Covariance that the errors which last add to an edge of unstated covariance if they change every metre or so.
Mat6 steady_covariance(const OdometryEdge& edge, const OdometryNoise& noise);

/// What was missed of a motion and the next. @param T_from_to of the second
MissedMotion join(const MissedMotion& first, const MissedMotion& second, const SE3& T_from_to);

/// The odometry over two edges, the second of which starts where the first ends.
OdometryEdge join(const OdometryEdge& first, const OdometryEdge& second);

/// The edges as the odometry had them; none if no solved motion took a place.
std::vector<OdometryEdge> measured_edges(const std::vector<OdometryEdge>& edges);

/// Length and turns of a way. Jitter about one place is no way, however many poses show it.
class WayCounter {
 public:
  /// Goes on from there: what lies between is no way.
  void start(const SE3& T_odom_camera) { T_odom_counted_ = T_odom_camera; }
  /// Needs a start.
  void add(const SE3& T_odom_camera);
  /// @return path in m and turns in rad since the last call
  std::pair<double, double> take() { return {std::exchange(path_m_, 0.0), std::exchange(rotation_rad_, 0.0)}; }

 private:
  SE3 T_odom_counted_;  ///< where the sums were added to last
  double path_m_ = 0.0, rotation_rad_ = 0.0;
};

/// Collects frames between two keyframes into an edge.
class OdometryAccumulator {
 public:
  /// Adds the motion from the previous frame. Call it once for every frame, in order.
  void add(const Frame& frame);
  /// The edge from the last keyframe to this one; the next edge starts here.
  OdometryEdge finish(const SE3& T_odom_from, const SE3& T_odom_to);

 private:
  std::optional<SE3> T_odom_previous_;
  WayCounter way_;
  OdometryEdge edge_;
  bool all_stated_ = true;
  Mat6 covariance_ = Mat6::Zero();
};

/// What a loop says about the odometry between its ends.
struct Innovation {
  Mat6 from_origin;  ///< carries a small motion at the first vertex's place into the loop's error
  Vec6 error;        ///< how far loop and odometry disagree, as the loop's error
  Vec6 jump;         ///< what of that suspected jumps let expect with a prior of 1
};

/// The odometry's noise summed along a chain of vertices, carried to the first: the difference of two sums is
/// the noise of the stretch between two vertices. Linear about the given poses, which need not be the odometry's.
class PathNoise {
 public:
  /// @param edges edges[i] joins vertices i and i + 1; both must outlive this
  PathNoise(const std::vector<SE3>& T_world_vertex, const std::vector<OdometryEdge>& edges);

  Innovation innovation(const GraphLoop& loop) const;
  /// Smallest factor on the noise at which a loop is as likely as a typical one (its chi^2 at the median); 0 if it is
  /// so without any odometry noise, infinity if even `max_factor` does not do.
  double explaining_factor(const GraphLoop& loop, const OdometryNoise& noise, double max_factor) const;
  /// Whether the source states a covariance somewhere between the loop's ends.
  bool has_stated(const GraphLoop& loop) const;

  /// From the first vertex to each.
  const std::vector<EdgeCovariance>& sums() const { return sums_; }
  /// Carries a small motion at the end of an edge to the first vertex's place, in the world's axes.
  const Mat6& to_origin(std::size_t edge) const { return to_origin_[edge]; }

 private:
  /// In the world's axes about the first vertex: carried far away, a small noise is lost among large ones.
  SE3 about_first(const SE3& T_world_vertex) const;

  const std::vector<SE3>* vertices_;
  std::vector<EdgeCovariance> sums_;
  std::vector<Mat6> to_origin_;
  std::vector<Vec6> residual_, jump_;
  std::vector<int> stated_;
};

}  // namespace semantic_topo_loop::core
