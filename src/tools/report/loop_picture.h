#pragma once

#include <string>

#include "tools/report/run_data.h"
#include "tools/report/top_view.h"

namespace semantic_topo_loop::core {

/// The two submaps of a loop side by side, as they were, seen from above and turned alike; lines join what was matched.
/// On the right both are on top of each other, as the loop says, and what is between the objects of a pair is red.
/// Arrow heads are the cameras, along their optical axes; those beyond a picture stand at its edge.
/// @param loop with objects   @return an SVG element
std::string draw_loop(const RunData& run, const ShownLoop& loop, const TopView& view, const ClassColors& colors);

}  // namespace semantic_topo_loop::core
