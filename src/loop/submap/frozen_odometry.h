#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include "loop/submap/observation_window.h"

namespace semantic_topo_loop::core {

/// Where the odometry stands still though the camera moves: a source that has lost track repeats its last pose, wheels
/// slip or are lifted. The boxes tell that from a camera that stands.
/// @return one a frame: whether it is so from this frame to the next; false for the last
std::vector<bool> frozen_motions(const std::deque<ObservedFrame>& window);
/// @return stamp of the frame that the last of them leads to; nullopt if there is none
std::optional<std::int64_t> last_frozen_ns(const std::deque<ObservedFrame>& window);

/// How the camera turned between two frames, if all that the boxes moved comes from turning: T_from_to.q.
Quaternion turn_by_boxes(const ObservedFrame& from, const ObservedFrame& to);

}  // namespace semantic_topo_loop::core
