#include <cstdio>
#include <iostream>
#include <string>

#include "apps/program.h"
#include "semantic_topo_loop/types/stamp.h"
#include "tools/g2o/g2o.h"

namespace {

using namespace semantic_topo_loop::apps;
using namespace semantic_topo_loop::core;

struct Arguments {
  std::string in, out;
  GraphOptimizerOptions options;
};

Status run(const Arguments& arguments) {
  G2oRefusals refusals;
  Result<G2oGraph> graph = read_g2o(arguments.in, &refusals);
  for (const std::string& refusal : refusals) std::cerr << "optimise_graph: refused: " << refusal << '\n';
  if (!graph) return graph.error();
  const Stopwatch stopwatch;
  const Result<GraphOptimizerReport> optimized = optimize_graph(&*graph, arguments.options);
  if (!optimized) return optimized.error();
  const GraphOptimizerReport& report = *optimized;
  const double seconds = 1e-6 * stopwatch.elapsed_us();
  for (const G2oEdge* edge : report.outliers) {
    std::cerr << "optimise_graph: outlier: edge " << edge->from << ' ' << edge->to << '\n';
  }
  for (const std::string& problem : report.unsolved) std::cerr << "optimise_graph: left as it is: " << problem << '\n';
  std::printf("vertices      %zu\nedges         %zu\nrefused       %zu\noutliers      %zu\nparts         %d\n",
              graph->vertices.size(), graph->edges.size(), refusals.size(), report.outliers.size(), report.components);
  std::printf("initial cost  %.9g\nfinal cost    %.9g\ninitial chi2  %.9g\nfinal chi2    %.9g\n", report.initial_cost,
              report.final_cost, report.initial_chi2, report.final_chi2);
  std::printf("iterations    %d\nseconds       %.3f\n", report.iterations, seconds);
  return write_g2o(arguments.out, *graph);
}

}  // namespace

int main(int argc, char** argv) {
  Arguments arguments;
  Command command{
      "", "IN.g2o OUT.g2o [--robust ...] [--initial ...]",
      "Optimises a pose graph (SE2 or SE3) and prints its cost before and after. Lines that cannot be used are\n"
      "named and left out.\n",
      [&arguments] { return run(arguments); }};
  command.words = {{"IN.g2o", &arguments.in}, {"OUT.g2o", &arguments.out}};
  command
      .option("robust", choice(&arguments.options.robust, GraphOptimizerOptions::robust_choices()),
              "how wrong loops are kept out (default: none)")
      .option("initial", choice(&arguments.options.initial, GraphOptimizerOptions::initial_choices()),
              "first guess (default: file, the vertices of IN); the chordal one is tried as well");
  return run_program("optimise_graph", {command}, argc, argv);
}
