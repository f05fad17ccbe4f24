#pragma once

#include <optional>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/local_map.h"

namespace semantic_topo_loop::core {

/// A run's submaps as a JSON file (docs/files.md), for loops into an earlier run. Poses are those of LocalMap::
/// T_odom_anchor, which should lead to the run's map then (pipeline/earlier_map.h).
bool write_submaps(const std::string& path, const std::vector<LocalMap>& submaps, std::string* error);

/// @param classes must know every class of the file and map it
/// @return nullopt, with file, field and value in `error`; a file without submaps is an error
std::optional<std::vector<LocalMap>> read_submaps(const std::string& path, const ClassTable& classes,
                                                  std::string* error);

}  // namespace semantic_topo_loop::core
