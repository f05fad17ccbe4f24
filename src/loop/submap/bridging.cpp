#include "loop/submap/bridging.h"

#include <algorithm>
#include <cmath>

#include "loop/submap/window_problem.h"
#include "odometry/odometry_edge.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

/// How far a camera in a hand goes from where its velocities before and after lead to, an axis: m in a time of one
/// second, growing with its square, and rad a second. Chosen on the motion capture's poses of fr1_xyz, fr2_desk and
/// fr3_office, over 0.4 to 1.5 s.
constexpr double kUsualSwerve_mps2 = 0.07, kUsualTurn_radps = 0.1;
/// Over which a velocity is measured.
constexpr double kVelocity_s = 0.15;

double seconds_between(const std::deque<ObservedFrame>& window, std::size_t from, std::size_t to) {
  return seconds_into(window, to) - seconds_into(window, from);
}

/// A stretch of the window from a frame to another, and the frames to which velocities are measured on either side.
struct Stretch {
  std::size_t before = 0, from = 0, to = 0, after = 0;
};

/// The first frame after one, or the last before it, to which a velocity can be measured.
std::optional<std::size_t> velocity_frame(const std::deque<ObservedFrame>& window, const std::vector<bool>& frozen,
                                          std::size_t frame, bool forward) {
  for (std::size_t i = frame;;) {
    if (std::abs(seconds_between(window, frame, i)) >= kVelocity_s) return i;
    if (forward ? i + 1 >= window.size() || frozen[i] : i == 0 || frozen[i - 1]) return std::nullopt;
    i = forward ? i + 1 : i - 1;
  }
}

std::optional<Stretch> stretch_of(const std::deque<ObservedFrame>& window, const std::vector<bool>& frozen,
                                  std::size_t from, std::size_t to) {
  const auto before = velocity_frame(window, frozen, from, false), after = velocity_frame(window, frozen, to, true);
  if (!before || !after) return std::nullopt;
  return Stretch{*before, from, to, *after};
}

/// The camera's motion over a stretch, of velocities that change evenly.
class Passage {
 public:
  Passage(const std::deque<ObservedFrame>& window, const Stretch& stretch)
      : time_s_(seconds_between(window, stretch.from, stretch.to)) {
    const auto pose = [&window](std::size_t i) -> const SE3& { return window[i].T_odom_camera; };
    const double before_s = seconds_between(window, stretch.before, stretch.from);
    const double after_s = seconds_between(window, stretch.to, stretch.after);
    v_from_ = pose(stretch.from).q.conjugate() * (pose(stretch.from).t - pose(stretch.before).t) / before_s;
    w_from_ = so3_log(pose(stretch.before).q.conjugate() * pose(stretch.from).q) / before_s;
    w_to_ = so3_log(pose(stretch.to).q.conjugate() * pose(stretch.after).q) / after_s;
    v_to_ = so3_exp(0.5 * time_s_ * (w_from_ + w_to_)) *
            (pose(stretch.to).q.conjugate() * (pose(stretch.after).t - pose(stretch.to).t) / after_s);
  }

  double time_s() const { return time_s_; }
  SE3 until(double share) const {
    const double t = share * time_s_, half = 0.5 * share;
    return {so3_exp(t * (w_from_ + half * (w_to_ - w_from_))), t * (v_from_ + half * (v_to_ - v_from_))};
  }

 private:
  Vec3 v_from_, v_to_, w_from_, w_to_;  ///< m/s and rad/s, in the camera as the stretch begins
  double time_s_ = 0.0;
};

/// Of a passage of so long: what is usual and what this camera does elsewhere in the window, half each.
Vec6 passage_variances(const std::deque<ObservedFrame>& window, const std::vector<bool>& frozen, double time_s) {
  double translation = 0.0, rotation = 0.0;
  int count = 0;
  std::size_t clean = 0;  // from here on up to `to` nothing is frozen
  for (std::size_t from = 0, to = 1; to < window.size(); ++to) {
    if (frozen[to - 1]) clean = to;
    while (from < to && (from < clean || seconds_between(window, from + 1, to) >= time_s)) ++from;
    if (seconds_between(window, from, to) < time_s) continue;
    const std::optional<Stretch> stretch = stretch_of(window, frozen, from, to);
    if (!stretch) continue;
    const SE3 motion = window[from].T_odom_camera.inverse() * window[to].T_odom_camera;
    const SE3 error = Passage(window, *stretch).until(1.0).inverse() * motion;
    translation += error.t.squaredNorm() / 3.0;
    rotation += so3_log(error.q).squaredNorm() / 3.0;
    ++count;
  }
  const double swerve_m = kUsualSwerve_mps2 * time_s * time_s, turn_rad = kUsualTurn_radps * time_s;
  const Mat6 usual = isotropic_covariance(swerve_m * swerve_m, turn_rad * turn_rad);
  if (count == 0) return usual.diagonal();
  return 0.5 * (usual + isotropic_covariance(translation / count, rotation / count)).diagonal();
}

/// The stretch that begins with the motion from a frame to the next, if it is to be bridged. One goes on over motions
/// that are too few to measure a velocity.
std::optional<Stretch> frozen_stretch(const std::deque<ObservedFrame>& window, const std::vector<bool>& frozen,
                                      std::size_t from) {
  if (frozen[from] || !frozen[from + 1]) return std::nullopt;
  for (std::size_t to = from + 3; to < window.size(); ++to) {
    if (frozen[to - 1]) continue;
    if (const auto stretch = stretch_of(window, frozen, from, to)) return stretch;
  }
  return std::nullopt;
}

}  // namespace

std::vector<std::optional<Vec6>> bridge(const std::vector<bool>& frozen, std::size_t anchor,
                                        std::deque<ObservedFrame>* window) {
  std::vector<std::optional<Vec6>> bridged(window->size());
  if (std::find(frozen.begin(), frozen.end(), true) == frozen.end()) return bridged;
  const std::deque<ObservedFrame> given = *window;
  for (std::size_t i = 0; i + 1 < given.size();) {
    const std::optional<Stretch> stretch = frozen_stretch(given, frozen, i);
    const SE3 T_odom_from = (*window)[i].T_odom_camera;
    if (!stretch) {
      (*window)[i + 1].T_odom_camera = T_odom_from * given[i].T_odom_camera.inverse() * given[i + 1].T_odom_camera;
      ++i;
      continue;
    }
    const Passage passage(given, *stretch);
    const Vec6 of_passage = passage_variances(given, frozen, passage.time_s());
    for (; i < stretch->to; ++i) {
      const double share = seconds_between(given, stretch->from, i + 1) / passage.time_s();
      (*window)[i + 1].T_odom_camera = T_odom_from * passage.until(share);
      bridged[i] = of_passage * (seconds_between(given, i, i + 1) / passage.time_s());
    }
  }
  const SE3 back = given[anchor].T_odom_camera * (*window)[anchor].T_odom_camera.inverse();
  for (ObservedFrame& frame : *window) frame.T_odom_camera = back * frame.T_odom_camera;
  return bridged;
}

}  // namespace semantic_topo_loop::core
