#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

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
/// @return nullopt, with the cause in `error`, if the file cannot be read, mixes SE2 and SE3, or holds no edge
std::optional<G2oGraph> read_g2o(const std::string& path, G2oRefusals* refusals, std::string* error);

/// Writes it, atomically, with every digit.
bool write_g2o(const std::string& path, const G2oGraph& graph, std::string* error);

}  // namespace semantic_topo_loop::core
