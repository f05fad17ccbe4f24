#pragma once

#include <string>
#include <vector>

#include "semantic_topo_loop/types/option_visitor.h"
#include "tools/g2o/g2o.h"

namespace semantic_topo_loop::core {

struct GraphOptimizerOptions {
  std::string robust = "none";
  std::string initial = "file";
  int max_iterations = 100;

  void visit(OptionVisitor& visitor) {
    visitor("robust", robust, one_of({"gnc", "none", "huber", "cauchy"}),
            "how false edges are kept out, of those that do not join consecutive ids");
    visitor("initial", initial, one_of({"file", "odometry", "spanning_tree", "chordal"}), "first guess of the poses");
    visitor("max_iterations", max_iterations, any(), "of one solve");
  }
};

struct GraphOptimizerReport {
  /// 0.5 sum r^T I r with r = (translation error, rotation vector), I in the file's order.
  double initial_cost = 0.0, final_cost = 0.0;
  /// As g2o has it: sum r^T I r with r = (translation error, vector part of the quaternion); planar: the angle.
  double initial_chi2 = 0.0, final_chi2 = 0.0;
  int iterations = 0;
  int components = 0;                    ///< parts that no edge joins; each keeps its fixed, else its first, vertex
  std::vector<const G2oEdge*> outliers;  ///< edges that were rejected (gnc); the figures above are without them
  /// Parts that could not be solved, and why; they stay as they are, and the figures above are without them.
  std::vector<std::string> unsolved;
};

/// Minimises g2o's chi2 over the vertices (Ceres, Levenberg-Marquardt, one thread). The chordal guess is
/// tried as well as the one asked for, unless that is the worse one to begin with, and the lower minimum taken. The
/// same input gives the same bytes.
/// @return false, with the cause in `error`, if no part can be solved; the graph is then unchanged
bool optimize_graph(G2oGraph* graph, const GraphOptimizerOptions& options, GraphOptimizerReport* report,
                    std::string* error);

}  // namespace semantic_topo_loop::core
