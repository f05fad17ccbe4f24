#pragma once

#include <string>
#include <vector>

#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/local_map.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// A run's submaps as a JSON file (docs/files.md), for loops into an earlier run. Poses are those of LocalMap::
/// T_odom_anchor, which should lead to the run's map then (pipeline/object_slam.h).
Status write_submaps(const std::string& path, const std::vector<LocalMap>& submaps);

/// @param classes must know every class of the file and map it
/// @return an error, with file, field and value; a file without submaps is an error
Result<std::vector<LocalMap>> read_submaps(const std::string& path, const ClassTable& classes);

}  // namespace semantic_topo_loop::core
