#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "semantic_topo_loop/types/frame.h"

namespace semantic_topo_loop::core {

/// Looks for bursts in which an odometry moves as no hand or robot does: the motion within up to 0.4 s is
/// compared with what the frames before and after foretell, and what exceeds the usual difference by far counts as a
/// suspected jump. In seconds: any frame rate.
class MotionBursts {
 public:
  MotionBursts();
  /// Takes in the next frame's pose; the motion to a pose after a break, or one that is not later, is left out.
  /// @param section of the path that the motion belongs to, not falling
  void push(const Frame& frame, std::size_t section);

  /// What stood out in a section: by so much the odometry may have jumped.
  struct SuspectedJump {
    Vec6 motion = Vec6::Zero();  ///< (m, rad), in the axes of the odometry
    /// 1 sigma of how far motions usually are from what is foretold: so far the jump, if it was one, may be off.
    double error_m = 0.0, error_rad = 0.0;
  };
  /// The last few frames have not been compared yet.
  SuspectedJump suspected_jump(std::size_t section) const;

 private:
  struct Motion {
    Vec6 twist;  ///< over the time
    Quaternion q_odom_camera;
    double dt_s = 0.0, end_s = 0.0;  ///< in the time of all motions
    std::size_t section = 0;
  };
  /// Norms of how far a motion was from what was foretold.
  struct Difference {
    double translation_m = 0.0, rotation_rad = 0.0, dt_s = 0.0;
  };
  /// Motions of so long, a frame at least.
  struct Length {
    double time_s = 0.0;
    std::deque<Difference> last;            ///< one a frame
    double known_s = 0.0;                   ///< sum of their times
    double sigma_m = 0.0, sigma_rad = 0.0;  ///< that is usual
    double outdated_s = 0.0;                ///< since that was asked

    void remember(const Difference& difference);
    void refresh();
  };
  struct Burst {
    double begin_s = 0.0, end_s = 0.0;
    double strength = 0.0;                                     ///< in sigmas of its length
    double size = 0.0;                                         ///< what of it is sure, in sigmas of the shortest length
    std::vector<std::pair<std::size_t, SuspectedJump>> jumps;  ///< by section
  };

  Burst judge(Length* length) const;
  void remember(const Burst& burst);
  void settle();

  std::array<Length, 6> lengths_;
  std::optional<SE3> T_odom_last_;
  std::int64_t last_stamp_ns_ = 0;
  std::deque<Motion> window_;
  double time_s_ = 0.0;                         ///< of all motions
  Burst greatest_;                              ///< of those that overlap at the end
  std::map<std::size_t, SuspectedJump> jumps_;  ///< by section, where one stood out, without those of greatest_
};

/// How long after its end a burst is noticed.
inline constexpr std::int64_t kBurstNoticed_ns = 167'000'000;

/// Tells jumps of the odometry by its motion alone, kBurstNoticed_ns after their end.
class BurstWatch {
 public:
  /// @return a jump that spoils a submap and has just been noticed: (m, rad), in the axes of the odometry
  std::optional<Vec6> push(const Frame& frame);

 private:
  MotionBursts bursts_;
  std::size_t section_ = 0;
  std::int64_t section_ns_ = 0;  ///< when the section began
};

}  // namespace semantic_topo_loop::core
