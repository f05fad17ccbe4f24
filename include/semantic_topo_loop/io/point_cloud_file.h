#pragma once

#include <string>

#include "semantic_topo_loop/map/point_map.h"

namespace semantic_topo_loop::core {

/// Writes the points of a map as PLY or PCD, by the file's ending, binary: x, y, z (m, map frame) and intensity, 1 for
/// sparse points, which come first, and 0 for semi-dense ones, as floats.
/// @return false, with path and cause in `error`, for another ending or a file that cannot be written
bool write_point_cloud(const std::string& path, const MapPoints& points, std::string* error);

}  // namespace semantic_topo_loop::core
