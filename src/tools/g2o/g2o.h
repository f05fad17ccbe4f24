#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "pose_graph/solver/graph_solver.h"
#include "semantic_topo_loop/types/option_visitor.h"
#include "semantic_topo_loop/types/result.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

struct G2oVertex {
  std::int64_t id = -1;
  SE3 T_world_vertex;
  bool is_fixed = false;  ///< named by a FIX line
};

struct G2oEdge {
  std::int64_t from = -1, to = -1;
  SE3 T_from_to;
  /// As in the file: of (x, y, z, qx, qy, qz), or, planar, of (x, y, angle) in rows and columns 0, 1 and 5.
  Mat6 information = Mat6::Identity();
  int line = 0;  ///< of the file; 0 if it comes from none
};

/// A pose graph as g2o's text files hold it. Planar graphs (SE2) lie in the plane z = 0.
struct G2oGraph {
  bool is_planar = false;
  std::vector<G2oVertex> vertices;  ///< in order of id
  std::vector<G2oEdge> edges;       ///< in order of the file
};

/// What was left out of a graph, and why, one text each: `<path>:<line>: <what and value>`.
using G2oRefusals = std::vector<std::string>;

/// Reads VERTEX_SE3:QUAT, EDGE_SE3:QUAT, VERTEX_SE2, EDGE_SE2 and FIX lines; `#` comments. Lines that cannot be used
/// (unknown tag, wrong number of fields, values that are no finite numbers, a quaternion of norm 0, an information
/// matrix that is not positive definite, an id given twice, an edge of a vertex with itself) are refused and the rest
/// is read. So are edges of vertices that have no line, unless no vertex has one: then the edges place them, each
/// vertex by the first edge that reaches it.
/// @param refusals added to, whether or not a graph comes out; may be null
/// @return an error, with the cause, if the file cannot be read, mixes SE2 and SE3, or holds no edge
Result<G2oGraph> read_g2o(const std::string& path, G2oRefusals* refusals);

/// Writes it, atomically, with every digit.
Status write_g2o(const std::string& path, const G2oGraph& graph);

struct GraphOptimizerOptions {
  std::string robust = "none";
  std::string initial = "file";
  int max_iterations = 100;

  static std::vector<std::string> robust_choices() { return {"gnc", "none", "huber", "cauchy"}; }
  static std::vector<std::string> initial_choices() { return {"file", "odometry", "spanning_tree", "chordal"}; }
  void visit(OptionVisitor& visitor) {
    visitor("robust", robust, one_of(robust_choices()),
            "how false edges are kept out, of those that do not join consecutive ids");
    visitor("initial", initial, one_of(initial_choices()), "first guess of the poses");
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
/// @return an error, with the cause, if no part can be solved; the graph is then unchanged
Result<GraphOptimizerReport> optimize_graph(G2oGraph* graph, const GraphOptimizerOptions& options);

}  // namespace semantic_topo_loop::core
