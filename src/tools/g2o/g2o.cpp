#include "tools/g2o/g2o.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/io/text_file.h"

namespace semantic_topo_loop::core {
namespace {

using Fields = std::vector<std::string_view>;

/// Rows of the 6-vector that a planar graph uses.
constexpr int kPlanarRows[] = {0, 1, 5};

SE3 planar_pose(const double* v) { return {so3_exp(Vec3(0.0, 0.0, v[2])), Vec3(v[0], v[1], 0.0)}; }

double planar_angle(const Quaternion& q) { return 2.0 * std::atan2(q.z(), q.w()); }

bool is_positive_definite(const Mat6& information) {
  const Eigen::SelfAdjointEigenSolver<Mat6> solver(information, Eigen::EigenvaluesOnly);
  return solver.info() == Eigen::Success && solver.eigenvalues()(0) > 0.0;
}

class Reader {
 public:
  Reader(const std::string& path, G2oRefusals* refusals) : path_(path), refusals_(refusals) {}

  std::optional<G2oGraph> read(std::string* error) {
    const std::optional<std::string> text = read_text_file(path_, error);
    if (!text) return std::nullopt;
    for (const TextLine& line : content_lines(*text)) {
      std::string problem;
      if (!take(split_blanks(line.text), line.number, &problem)) refuse(line.number, problem);
    }
    if (has_planar_ && has_spatial_) {
      *error = path_ + ": holds both SE2 and SE3 lines";
      return std::nullopt;
    }
    graph_.is_planar = has_planar_;
    place_edges();
    if (graph_.edges.empty()) {
      *error = path_ + ": holds no usable edge";
      return std::nullopt;
    }
    for (const auto& [id, vertex] : vertices_) {
      graph_.vertices.push_back(vertex);
      graph_.vertices.back().is_fixed = fixed_.count(id) != 0;
    }
    for (const auto& [id, line] : fixed_) {
      if (vertices_.count(id) == 0) refuse(line, "FIX of the unknown vertex " + std::to_string(id));
    }
    return std::move(graph_);
  }

 private:
  void refuse(int line, const std::string& problem) {
    if (refusals_ != nullptr) refusals_->push_back(at_line(path_, line, problem));
  }

  bool take(const Fields& fields, int line, std::string* problem) {
    const std::string tag(fields.front());
    if (tag == "VERTEX_SE3:QUAT") return take_vertex(fields, 7, problem);
    if (tag == "VERTEX_SE2") return take_vertex(fields, 3, problem);
    if (tag == "EDGE_SE3:QUAT") return take_edge(fields, 7, 21, line, problem);
    if (tag == "EDGE_SE2") return take_edge(fields, 3, 6, line, problem);
    if (tag == "FIX") return take_fixed(fields, line, problem);
    *problem = "unknown tag '" + tag + "'";
    return false;
  }

  static bool read_id(std::string_view field, std::int64_t* id, std::string* problem) {
    const std::optional<std::int64_t> value = parse_integer(field);
    if (!value || *value < 0) {
      *problem = "id '" + std::string(field) + "' is no number >= 0";
      return false;
    }
    *id = *value;
    return true;
  }

  /// Ids and numbers of a line; the tag is the first field.
  static bool read_values(const Fields& fields, std::size_t ids, std::size_t numbers, std::vector<std::int64_t>* id,
                          std::vector<double>* values, std::string* problem) {
    if (fields.size() != 1 + ids + numbers) {
      *problem = std::string(fields.front()) + " has " + std::to_string(fields.size() - 1) + " values instead of " +
                 std::to_string(ids + numbers);
      return false;
    }
    id->resize(ids);
    for (std::size_t i = 0; i < ids; ++i) {
      if (!read_id(fields[1 + i], &(*id)[i], problem)) return false;
    }
    for (std::size_t i = 1 + ids; i < fields.size(); ++i) {
      const std::optional<double> value = parse_double(fields[i]);
      constexpr double kMax = 1e30;  // the error of an edge, squared and weighed, must stay finite
      if (!value || !(std::abs(*value) <= kMax)) {
        *problem = std::string(fields.front()) + named(*id) + ": '" + std::string(fields[i]) + "' is no finite number";
        if (value && std::isfinite(*value)) *problem += " below 1e30";
        return false;
      }
      values->push_back(*value);
    }
    return true;
  }

  static std::string named(const std::vector<std::int64_t>& id) {
    std::string text;
    for (const std::int64_t i : id) text += " " + std::to_string(i);
    return text;
  }

  bool to_pose(const std::vector<double>& values, std::size_t numbers, SE3* T, std::string* problem) {
    (numbers == 3 ? has_planar_ : has_spatial_) = true;
    if (numbers == 3) {
      *T = planar_pose(values.data());
      return true;
    }
    const Quaternion q(values[6], values[3], values[4], values[5]);
    constexpr double kMinNorm = 1e-6;
    if (q.norm() < kMinNorm) {
      *problem = "quaternion of norm 0 is no rotation";
      return false;
    }
    *T = SE3(q.normalized(), Vec3(values[0], values[1], values[2]));
    return true;
  }

  bool take_vertex(const Fields& fields, std::size_t numbers, std::string* problem) {
    std::vector<std::int64_t> id;
    std::vector<double> values;
    if (!read_values(fields, 1, numbers, &id, &values, problem)) return false;
    G2oVertex vertex;
    vertex.id = id.front();
    if (!to_pose(values, numbers, &vertex.T_world_vertex, problem)) return false;
    if (vertices_.emplace(vertex.id, vertex).second) return true;
    *problem = "vertex " + std::to_string(vertex.id) + " is given twice";
    return false;
  }

  bool take_edge(const Fields& fields, std::size_t numbers, std::size_t weights, int line, std::string* problem) {
    std::vector<std::int64_t> id;
    std::vector<double> values;
    if (!read_values(fields, 2, numbers + weights, &id, &values, problem)) return false;
    G2oEdge edge;
    edge.from = id[0];
    edge.to = id[1];
    edge.line = line;
    const std::string name = "edge " + std::to_string(edge.from) + " " + std::to_string(edge.to);
    if (edge.from == edge.to) {
      *problem = name + " joins a vertex to itself";
      return false;
    }
    if (!to_pose(values, numbers, &edge.T_from_to, problem)) {
      *problem = name + ": " + *problem;
      return false;
    }
    const double* at = values.data() + numbers;
    const int size = numbers == 3 ? 3 : 6;
    for (int i = 0; i < size; ++i) {
      for (int j = i; j < size; ++j) {
        const int r = size == 3 ? kPlanarRows[i] : i, c = size == 3 ? kPlanarRows[j] : j;
        edge.information(r, c) = edge.information(c, r) = *at++;
      }
    }
    if (!is_positive_definite(edge.information)) {
      *problem = name + ": its information matrix is not positive definite";
      return false;
    }
    graph_.edges.push_back(edge);
    return true;
  }

  bool take_fixed(const Fields& fields, int line, std::string* problem) {
    if (fields.size() < 2) {
      *problem = "FIX names no vertex";
      return false;
    }
    for (std::size_t i = 1; i < fields.size(); ++i) {
      std::int64_t id = -1;
      if (!read_id(fields[i], &id, problem)) return false;
      fixed_.emplace(id, line);
    }
    return true;
  }

  /// Places the vertices of a file that has none, and refuses edges that lead nowhere.
  void place_edges() {
    if (vertices_.empty()) {
      for (const G2oEdge& edge : graph_.edges) place(edge);
    }
    std::vector<G2oEdge> usable;
    for (const G2oEdge& edge : graph_.edges) {
      const bool knows_from = vertices_.count(edge.from) != 0, knows_to = vertices_.count(edge.to) != 0;
      if (knows_from && knows_to) {
        usable.push_back(edge);
        continue;
      }
      refuse(edge.line, "edge " + std::to_string(edge.from) + " " + std::to_string(edge.to) +
                            " leads to the unknown vertex " + std::to_string(knows_from ? edge.to : edge.from));
    }
    graph_.edges = std::move(usable);
  }

  void place(const G2oEdge& edge) {
    if (vertices_.count(edge.from) == 0 && vertices_.count(edge.to) == 0) {
      vertices_[edge.from] = {edge.from, SE3(), false};
    }
    const auto from = vertices_.find(edge.from), to = vertices_.find(edge.to);
    if (from != vertices_.end() && to == vertices_.end()) {
      vertices_[edge.to] = {edge.to, from->second.T_world_vertex * edge.T_from_to, false};
    } else if (from == vertices_.end() && to != vertices_.end()) {
      vertices_[edge.from] = {edge.from, to->second.T_world_vertex * edge.T_from_to.inverse(), false};
    }
  }

  const std::string& path_;
  G2oRefusals* refusals_;
  G2oGraph graph_;
  std::map<std::int64_t, G2oVertex> vertices_;
  std::map<std::int64_t, int> fixed_;  ///< id to line
  bool has_planar_ = false, has_spatial_ = false;
};

std::string number(double value) { return " " + format_general(value, 17); }

std::string format_pose(const SE3& T, bool is_planar) {
  if (is_planar) return number(T.t.x()) + number(T.t.y()) + number(planar_angle(T.q));
  std::string text;
  for (int i = 0; i < 3; ++i) text += number(T.t(i));
  for (int i = 0; i < 4; ++i) text += number(T.q.coeffs()(i));
  return text;
}

std::string format_edge(const G2oEdge& edge, bool is_planar) {
  std::string text = is_planar ? "EDGE_SE2 " : "EDGE_SE3:QUAT ";
  text += std::to_string(edge.from) + " " + std::to_string(edge.to) + format_pose(edge.T_from_to, is_planar);
  const int size = is_planar ? 3 : 6;
  for (int i = 0; i < size; ++i) {
    for (int j = i; j < size; ++j) {
      text += number(edge.information(is_planar ? kPlanarRows[i] : i, is_planar ? kPlanarRows[j] : j));
    }
  }
  return text + "\n";
}

}  // namespace

std::optional<G2oGraph> read_g2o(const std::string& path, G2oRefusals* refusals, std::string* error) {
  std::string problem;
  auto graph = Reader(path, refusals).read(&problem);
  if (!graph && error != nullptr) *error = problem;
  return graph;
}

bool write_g2o(const std::string& path, const G2oGraph& graph, std::string* error) {
  std::string text;
  for (const G2oVertex& vertex : graph.vertices) {
    text += (graph.is_planar ? "VERTEX_SE2 " : "VERTEX_SE3:QUAT ") + std::to_string(vertex.id) +
            format_pose(vertex.T_world_vertex, graph.is_planar) + "\n";
    if (vertex.is_fixed) text += "FIX " + std::to_string(vertex.id) + "\n";
  }
  for (const G2oEdge& edge : graph.edges) text += format_edge(edge, graph.is_planar);
  return write_text_file(path, text, error);
}

}  // namespace semantic_topo_loop::core
