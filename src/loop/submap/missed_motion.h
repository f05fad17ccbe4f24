#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include "loop/submap/observation_window.h"
#include "odometry/odometry_delay.h"

namespace semantic_topo_loop::core {

struct WindowSolution;

/// Where the odometry stands still though the camera moves: a source that has lost track repeats its last pose, wheels
/// are lifted. The boxes tell that from a camera that stands.
/// @return one a frame: whether it is so from this frame to the next; false for the last
std::vector<bool> frozen_motions(const std::deque<ObservedFrame>& window);
/// @return stamp of the frame that the last of them leads to; nullopt if there is none
std::optional<std::int64_t> last_frozen_ns(const std::deque<ObservedFrame>& window);

/// How the camera turned between two frames, if all that the boxes moved comes from turning: T_from_to.q.
Quaternion turn_by_boxes(const ObservedFrame& from, const ObservedFrame& to);

/// The odometry goes another way than the camera: wheels slip in a turn, a tracker follows what moves.
struct Slip {
  std::size_t from = 0, to = 0;  ///< the frames between which it was found
  /// Behind the odometry's motion, it puts the objects where they are seen, if all that was missed is turning.
  Quaternion turn = Quaternion::Identity();
};
/// Whether half of the objects in view or more have moved, at least two of them and half of those alike, from where the
/// odometry since the last frame that was solved for would have them now.
/// @param window poses as the odometry has them   @param noise, delay of them   @return nullopt without two such
/// objects
std::optional<Slip> find_slip(const std::deque<ObservedFrame>& window, const WindowSolution& solved,
                              const ShortTermNoise& noise, const OdometryDelay& delay);

}  // namespace semantic_topo_loop::core
