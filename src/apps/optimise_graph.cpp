#include <cstdio>
#include <iostream>
#include <string>

#include "apps/command_line.h"
#include "semantic_topo_loop/types/stamp.h"
#include "tools/g2o/g2o.h"
#include "tools/g2o/graph_optimizer.h"

namespace {

using namespace semantic_topo_loop::apps;
using namespace semantic_topo_loop::core;

constexpr char kUsage[] =
    "usage: optimise_graph IN.g2o OUT.g2o [--robust gnc|none|huber|cauchy]\n"
    "                      [--initial file|odometry|spanning_tree|chordal]\n"
    "Optimises a pose graph (SE2 or SE3) and prints its cost before and after.\n"
    "  --robust   how wrong loops are kept out (default: none)\n"
    "  --initial  first guess (default: file, the vertices of IN); the chordal one is tried as well\n"
    "Lines that cannot be used are named and left out.\n";

struct Arguments {
  std::string in, out;
  GraphOptimizerOptions options;
};

bool read(CommandLine* line, Arguments* arguments, std::string* error) {
  line->required("IN.g2o", &arguments->in);
  line->required("OUT.g2o", &arguments->out);
  line->text("--robust", &arguments->options.robust);
  line->text("--initial", &arguments->options.initial);
  if (!line->read(error)) return false;
  const Status status = validate(arguments->options);
  *error = status.message();
  return static_cast<bool>(status);
}

bool run(const Arguments& arguments, std::string* error) {
  G2oRefusals refusals;
  std::optional<G2oGraph> graph = read_g2o(arguments.in, &refusals, error);
  for (const std::string& refusal : refusals) std::cerr << "optimise_graph: refused: " << refusal << '\n';
  if (!graph) return false;
  GraphOptimizerReport report;
  const Stopwatch stopwatch;
  if (!optimize_graph(&*graph, arguments.options, &report, error)) return false;
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
  return write_g2o(arguments.out, *graph, error);
}

}  // namespace

int main(int argc, char** argv) {
  return run_program("optimise_graph", kUsage, {make_command("", read, run)}, argc, argv);
}
