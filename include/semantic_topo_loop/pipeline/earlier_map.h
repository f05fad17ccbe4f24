#pragma once

#include <vector>

#include "semantic_topo_loop/types/local_map.h"
#include "semantic_topo_loop/types/map_correction.h"

namespace semantic_topo_loop::core {

/// Takes submaps from the odometry's world and unit of length to the map's, so that a later run can be placed in it.
/// @param keyframes of the last solution, ascending; submaps of later keyframes move with T_map_odom
void move_to_map(const std::vector<KeyframePose>& keyframes, const SE3& T_map_odom, std::vector<LocalMap>* submaps);

}  // namespace semantic_topo_loop::core
