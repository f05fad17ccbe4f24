#pragma once

#include <optional>
#include <string>
#include <vector>

#include "semantic_topo_loop/evaluation/loop_evaluation.h"
#include "semantic_topo_loop/evaluation/object_evaluation.h"

namespace semantic_topo_loop::core {

/// Readers of a run's files and of the reference objects. Columns are found by the names in the header, so that their
/// order is free and more of them do no harm.
/// @return nullopt, with file, line, column and value in `error`
std::optional<std::vector<MappedObject>> read_objects(const std::string& path, std::string* error);
std::optional<std::vector<LoopRecord>> read_loops(const std::string& path, std::string* error);
std::optional<std::vector<ReferenceObject>> read_reference_objects(const std::string& path, std::string* error);

}  // namespace semantic_topo_loop::core
