#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>

#include "loop/submap/observation_window.h"
#include "loop/submap/window_problem.h"
#include "odometry/odometry_delay.h"
#include "odometry/short_term_noise.h"

namespace semantic_topo_loop::core {

struct WindowEvidence {
  ShortTermNoiseEstimator noise;
  OdometryDelay delay;
  double box_factor = 1.0;
  double doubt_radps = 0.0;  ///< what is left in doubt of the camera's orientation, a second away from the anchor
};

/// Solves a window of frames for the camera's motion and the objects on all sides of their boxes, since an odometry of
/// robots and cameras is off by centimetres within the seconds of a submap. How far the odometry is to be trusted is
/// learnt from window to window by the evidence of the boxes (ShortTermNoiseEstimator), so that a good odometry is left
/// as it is; and so is how late its poses are. In seconds, metres and radians: any frame rate. Each window begins with
/// what the one before has found, so that two steps solve most.
class WindowSolver {
 public:
  WindowSolver();
  ~WindowSolver();
  /// @param window frames, poses in any world   @param anchor index of the frame that stays where it is
  /// @return the same frames at the poses found; as they are if they are few, or not in order of time
  std::deque<ObservedFrame> solve(std::deque<ObservedFrame> window, std::size_t anchor);
  /// Whether it was slipping at the end of the last window.
  bool is_slipping() const { return is_slipping_; }
  /// @return stamp of the last frame to which the odometry is found to have slipped within a window, of which most was
  /// in the last one; nullopt if it has not
  std::optional<std::int64_t> last_slipped_ns(const std::deque<ObservedFrame>& window);
  WindowNoise noise() const { return {evidence_.noise.noise(), evidence_.box_factor}; }
  /// By how much the odometry's poses are late, as the windows so far tell, see OdometryDelay.
  double delay_s() const { return evidence_.delay.seconds(); }
  /// The delay that was taken out of the last window.
  double applied_delay_s() const { return applied_delay_s_; }
  /// How long a window may be for the orientation at its ends, seen from the middle, to be known to a sigma (rad).
  /// @return nullopt before anything is learnt
  std::optional<double> span_s(double sigma_rad) const;

 private:
  struct Memory;

  /// Remembers a slip up to the window's last frame.
  std::optional<Slip> watch(const std::deque<ObservedFrame>& window);
  /// Whether what was taken for a slip goes on for so long that it is how the odometry is, which is learnt.
  bool is_lasting(const std::deque<ObservedFrame>& window) const;

  WindowEvidence evidence_;
  double applied_delay_s_ = 0.0;
  bool is_slipping_ = false;
  std::int64_t learnt_ns_ = 0;      ///< stamp of the window that was learnt from last
  std::unique_ptr<Memory> memory_;  ///< of the equations, which every window needs anew: a megabyte
};

}  // namespace semantic_topo_loop::core
