#pragma once

#include <cstddef>
#include <deque>
#include <optional>
#include <vector>

#include "loop/submap/observation_window.h"

namespace semantic_topo_loop::core {

/// Moves the camera through stretches in which the odometry stood still: its velocities before and after them go over
/// into each other. The motions next to a stretch, of which the odometry may have followed a part, belong to it. A
/// stretch without velocities on both sides stays as it is.
/// @param frozen of frozen_motions   @param anchor frame whose pose stays
/// @return one a frame: variances (m^2, rad^2) of the motion to the next frame where it was bridged
std::vector<std::optional<Vec6>> bridge(const std::vector<bool>& frozen, std::size_t anchor,
                                        std::deque<ObservedFrame>* window);

}  // namespace semantic_topo_loop::core
