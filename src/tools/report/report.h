#pragma once

#include <string>

#include "semantic_topo_loop/types/result.h"
#include "tools/report/run_data.h"

namespace semantic_topo_loop::core {

/// What came out of a run, as one HTML page that needs no other file: trajectories, objects, loops, errors, times and
/// memory. The same files give the same bytes.
/// @return an error that names the file, and the line, if one is missing or damaged
Result<std::string> make_report(const ReportInputs& inputs);

/// Writes it into the run's directory, as report.html.
Status write_report(const ReportInputs& inputs);

}  // namespace semantic_topo_loop::core
