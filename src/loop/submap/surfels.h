#pragma once

#include <deque>
#include <memory>
#include <vector>

#include "loop/submap/observation_window.h"
#include "semantic_topo_loop/types/local_map.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// The surfaces that the window's points show: one surfel in each cube of 6 cm where they are flat over three cubes. At
/// most 2000 of them, evenly taken: 48 KB.
/// @param T_local_odom into the frame of the surfels   @return null if no frame came with points
std::shared_ptr<const std::vector<Surfel>> make_surfels(const std::deque<ObservedFrame>& window,
                                                        const SE3& T_local_odom);

}  // namespace semantic_topo_loop::core
