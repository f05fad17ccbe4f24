#pragma once

#include <optional>
#include <string>

#include "semantic_topo_loop/types/class_table.h"

namespace semantic_topo_loop::core {

/// Reads a class table such as config/classes_coco.yaml:
/// `classes: [{id, name, role: static|movable|dynamic|ignore, group, size_prior_m}]`; group and size_prior_m are
/// optional.
/// @return nullopt, with file, line, key and value in `error`, for anything else
std::optional<ClassTable> read_class_table(const std::string& path, std::string* error);

}  // namespace semantic_topo_loop::core
