#pragma once

#include <memory>
#include <ostream>
#include <string>

#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

struct MapState;

/// Writes a map as a SQLite database (docs/files.md), beside the file whose place it then takes: a crash or a full disk
/// leaves what was there.
Status write_map(const std::string& path, const MapState& map, const ClassTable& classes);

/// What is read of a map beside its graph; with the submaps what was refused between them.
struct MapParts {
  bool objects = false, submaps = false, points = false;
};

/// @param classes must have every class of the map under the same name, and map it
/// @return an error, with file, row and field, if the file is damaged or of another version, or does not fit together
Result<std::shared_ptr<const MapState>> read_map(const std::string& path, const ClassTable& classes,
                                                 MapParts parts = {true, true, true});

/// Prints every row of a map, in order, with what is packed in it as JSON: two maps are the same if their dumps are.
Status dump_map(const std::string& path, std::ostream& out);

}  // namespace semantic_topo_loop::core
