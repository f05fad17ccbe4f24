#include "tools/report/report.h"

#include "apps/program.h"

namespace {

using namespace semantic_topo_loop::apps;
using namespace semantic_topo_loop::core;

/// Whether the arguments that belong together are there.
Status check(const ReportInputs& inputs) {
  if (!inputs.reference.empty() && inputs.truth.empty()) return Error{"argument --reference needs --groundtruth"};
  if (inputs.with_scale && inputs.truth.empty()) return Error{"argument --scale needs --groundtruth"};
  return {};
}

}  // namespace

int main(int argc, char** argv) {
  ReportInputs inputs;
  int loop = 0;
  Command command{"", "RUN_DIR [--groundtruth FILE [--reference CSV] [--scale]] [--odometry FILE] [--loop N]",
                  "Shows a run of offline or of the Recorder as one HTML page, report.html in its directory.\n",
                  [&] {
                    if (loop > 0) inputs.loop = loop;
                    return write_report(inputs);
                  },
                  [&inputs] { return check(inputs); }};
  command.words = {{"RUN_DIR", &inputs.run}};
  command
      .option("groundtruth", po::value(&inputs.truth),
              "true trajectory, TUM format: everything is shown in its world, whose z axis is up")
      .option("reference", po::value(&inputs.reference), "reference objects in that world, see docs/files.md")
      .option("scale", po::bool_switch(&inputs.with_scale), "align by a similarity (monocular odometry)")
      .option("odometry", po::value(&inputs.odometry), "the trajectory that the run was given, to be shown too")
      .option("loop", number(&loop, 1), "the accepted loop to be shown first (default: that of most objects)");
  return run_program("report", {command}, argc, argv);
}
