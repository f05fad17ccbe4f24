#pragma once

#include <string>
#include <vector>

#include "semantic_topo_loop/types/loop_closure.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// Lines of loops.csv (docs/files.md), with their end of line.
std::string loop_table_header();
std::string loop_table_row(const LoopFigures& loop);

/// Writes loops to be handed to the pose graph, as loops.csv; `sigma_m` and `sigma_deg` are what the covariance
/// says of translation and rotation, the root of its trace.
Status write_given_loops(const std::string& path, const std::vector<LoopClosure>& loops);

}  // namespace semantic_topo_loop::core
