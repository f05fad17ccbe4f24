#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <vector>

#include "loop/submap/missed_motion.h"
#include "loop/submap/observation_window.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {

using Vec5 = Eigen::Matrix<double, 5, 1>;

/// What is taken for the errors of a window's odometry and boxes.
struct WindowNoise {
  ShortTermNoise odometry;
  double box_factor = 1.0;  ///< on the sigmas that boxes are usually known by
};

/// A box at a knot.
struct WindowView {
  std::size_t knot = 0;
  Box box;                     ///< on the plane z = 1
  std::uint8_t truncated = 0;  ///< Truncation bits: these sides bound nothing
  double sigma = 1.0;

  bool bounds(int side) const { return (truncated & (1 << side)) == 0; }
  int cut_sides() const { return !bounds(0) + !bounds(1) + !bounds(2) + !bounds(3); }
};

/// What stays in view of one object: its place (m), and the logarithms of half its width and height (log m), which
/// change so slowly with the direction it is seen from that they count as constant.
struct WindowTrack {
  std::int64_t id = -1;  ///< ObservedBox::track_id
  Vec5 start = Vec5::Zero();
  std::vector<WindowView> views;  ///< in order of their knots
};

/// What a window ended with, most of which is in the next one too.
struct WindowSolution {
  std::map<std::int64_t, SE3> T_odom_camera;  ///< of its frames, by stamp (ns)
  std::map<std::int64_t, Vec5> objects;       ///< by track

  const SE3* find(std::int64_t stamp_ns) const;
};

/// Where the odometry does not follow the camera, one a frame: from this frame to the next.
struct Unfollowed {
  std::vector<bool> missed;
  std::vector<std::optional<Vec6>> bridged;  ///< variances of missed ones that are known by what was before and after
  std::optional<Slip> slip;                  ///< the last of them, if it is one
};

/// The camera's motion through a window, and the objects that it sees there, as they are to be solved for.
struct WindowProblem {
  std::vector<SE3> T_odom_knot;                 ///< as the odometry has them
  std::vector<std::optional<Vec6>> velocities;  ///< there: (m/s, rad/s), camera frame; nothing where frames are sparse
  std::vector<SE3> start;                       ///< of the knots
  std::vector<double> times_s;
  std::vector<std::size_t> drift_of;   ///< of each step, from a knot to the next
  std::vector<double> missed_s;        ///< of each step: for how long the odometry did not follow the camera
  std::vector<Vec6> missed_variances;  ///< of what the odometry is off by for that
  std::vector<WindowTrack> tracks;
  std::size_t anchor = 0;  ///< the knot that stays where it is
  WindowNoise noise;

  /// @param knots the frames that poses are solved for   @param anchor one of them
  /// @param last of the window before, from where what is known goes on
  WindowProblem(const std::deque<ObservedFrame>& window, const std::vector<std::size_t>& knots, std::size_t anchor,
                const Unfollowed& unfollowed, const WindowNoise& noise, const WindowSolution& last);

  std::size_t steps() const { return T_odom_knot.size() - 1; }
  std::size_t drifts() const { return drift_of.back() + 1; }
  double duration_s(std::size_t step) const { return times_s[step + 1] - times_s[step]; }
  SE3 odometry(std::size_t step) const { return T_odom_knot[step].inverse() * T_odom_knot[step + 1]; }
  bool is_missed(std::size_t step) const { return missed_s[step] > 0.0; }
  /// Of the errors of a step, the drift taken off.
  Vec6 step_variances(std::size_t step) const;
  Vec6 drift_variances() const;

 private:
  SE3 start_knots(const std::deque<ObservedFrame>& window, const std::vector<std::size_t>& knots,
                  const Unfollowed& unfollowed, const WindowSolution& last);
};

/// Frames that poses are solved for, the first, the last and the anchor among them.
std::vector<std::size_t> knots_of(const std::deque<ObservedFrame>& window, std::size_t anchor);
/// Boxes of fewer knots say nothing.
constexpr std::size_t kMinWindowViews = 4;

double seconds_into(const std::deque<ObservedFrame>& window, std::size_t frame);

/// An object as its views share it.
struct SizedPoint {
  explicit SizedPoint(const Vec5& object) : center(object.head<3>()), half(object.tail<2>().array().exp()) {}

  Vec3 center;  ///< m
  Vec2 half;    ///< of its width and height, m
};

/// The same in the camera of a view.
struct SizedProjection {
  Vec3 in_camera;
  Vec4 residual;  ///< sides predicted less those of the box, in sigmas; 0 where they are cut
};
/// @return nullopt behind the camera
std::optional<SizedProjection> project(const WindowView& view, const SE3& T_odom_camera, const SizedPoint& object);
/// Squared residual of an object behind the camera: more than of any in view.
constexpr double kUnseenChi2 = 2300.0;

}  // namespace semantic_topo_loop::core
