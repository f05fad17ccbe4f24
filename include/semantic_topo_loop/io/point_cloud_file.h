#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "semantic_topo_loop/map/point_map.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// Whether the path's ending names a format that write_point_cloud knows.
bool is_point_cloud_path(const std::string& path);

/// Writes the points of a map as PLY or PCD, by the file's ending, binary: x, y, z (m, map frame) and intensity, 1 for
/// sparse points, which come first, and 0 for semi-dense ones, as floats.
/// @param objects if not empty, for each point the id of the object it lies on (-1: none), which is written too
/// (object, 32-bit integer)
/// @return an error, with path and cause, for another ending or a file that cannot be written
Status write_point_cloud(const std::string& path, const MapPoints& points,
                         const std::vector<std::int64_t>& objects = {});

}  // namespace semantic_topo_loop::core
