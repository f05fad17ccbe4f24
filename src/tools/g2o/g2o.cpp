#include "tools/g2o/g2o.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/SVD>
#include <Eigen/SparseCholesky>
#include <boost/pending/disjoint_sets.hpp>
#include <cmath>
#include <deque>
#include <map>

#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/io/text_file.h"

namespace semantic_topo_loop::core {
namespace {

using Fields = std::vector<std::string_view>;

/// Row and column of the upper triangle's entries, in order of the file. A planar graph uses rows 0, 1 and 5.
std::vector<std::pair<int, int>> information_places(bool is_planar) {
  const std::vector<int> rows = is_planar ? std::vector<int>{0, 1, 5} : std::vector<int>{0, 1, 2, 3, 4, 5};
  std::vector<std::pair<int, int>> places;
  for (auto r = rows.begin(); r != rows.end(); ++r) {
    for (auto c = r; c != rows.end(); ++c) places.emplace_back(*r, *c);
  }
  return places;
}

SE3 planar_pose(const double* v) { return {so3_exp(Vec3(0.0, 0.0, v[2])), Vec3(v[0], v[1], 0.0)}; }

double planar_angle(const Quaternion& q) { return 2.0 * std::atan2(q.z(), q.w()); }

bool is_positive_definite(const Mat6& information) {
  const Eigen::SelfAdjointEigenSolver<Mat6> solver(information, Eigen::EigenvaluesOnly);
  return solver.info() == Eigen::Success && solver.eigenvalues()(0) > 0.0;
}

class Reader {
 public:
  Reader(const std::string& path, G2oRefusals* refusals) : path_(path), refusals_(refusals) {}

  Result<G2oGraph> read() {
    const Result<std::string> text = read_text_file(path_);
    if (!text) return text.error();
    for (const TextLine& line : content_lines(*text)) {
      if (const Status taken = take(split_blanks(line.text), line.number); !taken) refuse(line.number, taken.message());
    }
    if (has_planar_ && has_spatial_) return Error{path_ + ": holds both SE2 and SE3 lines"};
    graph_.is_planar = has_planar_;
    place_edges();
    if (graph_.edges.empty()) return Error{path_ + ": holds no usable edge"};
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

  Status take(const Fields& fields, int line) {
    const std::string tag(fields.front());
    if (tag == "FIX") return take_fixed(fields, line);
    const bool is_planar = tag == "VERTEX_SE2" || tag == "EDGE_SE2",
               is_edge = tag == "EDGE_SE2" || tag == "EDGE_SE3:QUAT";
    if (!is_planar && !is_edge && tag != "VERTEX_SE3:QUAT") return Error{"unknown tag '" + tag + "'"};
    const std::size_t pose_size = is_planar ? 3 : 7, weights = is_edge ? information_places(is_planar).size() : 0;
    const Result<Values> values = read_values(fields, is_edge ? 2 : 1, pose_size + weights);
    if (!values) return values.error();
    const std::int64_t from = values->ids.front(), to = values->ids.back();
    const std::string name =
        is_edge ? "edge " + std::to_string(from) + " " + std::to_string(to) : "vertex " + std::to_string(from);
    if (is_edge && from == to) return Error{name + " joins a vertex to itself"};
    (is_planar ? has_planar_ : has_spatial_) = true;
    const double* v = values->numbers.data();
    constexpr double kMinNorm = 1e-6;
    const Quaternion q = is_planar ? Quaternion::Identity() : Quaternion(v[6], v[3], v[4], v[5]);
    if (q.norm() < kMinNorm) return Error{(is_edge ? name + ": " : "") + "quaternion of norm 0 is no rotation"};
    const SE3 T = is_planar ? planar_pose(v) : SE3(q.normalized(), Vec3(v[0], v[1], v[2]));
    if (is_edge) return take_edge(name, {from, to, T, Mat6::Identity(), line}, v + pose_size, is_planar);
    return vertices_.emplace(from, G2oVertex{from, T, false}).second ? Status() : Error{name + " is given twice"};
  }

  Status take_edge(const std::string& name, G2oEdge edge, const double* information, bool is_planar) {
    for (const auto& [r, c] : information_places(is_planar)) {
      edge.information(r, c) = edge.information(c, r) = *information++;
    }
    if (!is_positive_definite(edge.information))
      return Error{name + ": its information matrix is not positive definite"};
    graph_.edges.push_back(edge);
    return {};
  }

  static Result<std::int64_t> read_id(std::string_view field) {
    const std::optional<std::int64_t> value = parse_integer(field);
    if (!value || *value < 0) return Error{"id '" + std::string(field) + "' is no number >= 0"};
    return *value;
  }

  /// Ids and numbers of a line; the tag is the first field.
  struct Values {
    std::vector<std::int64_t> ids;
    std::vector<double> numbers;
  };
  static Result<Values> read_values(const Fields& fields, std::size_t ids, std::size_t numbers) {
    std::string name(fields.front());
    if (fields.size() != 1 + ids + numbers) {
      return Error{name + " has " + std::to_string(fields.size() - 1) + " values instead of " +
                   std::to_string(ids + numbers)};
    }
    Values values;
    for (std::size_t i = 1; i <= ids; ++i) {
      const Result<std::int64_t> id = read_id(fields[i]);
      if (!id) return id.error();
      values.ids.push_back(*id);
      name += " " + std::to_string(*id);
    }
    for (std::size_t i = 1 + ids; i < fields.size(); ++i) {
      const std::optional<double> value = parse_double(fields[i]);
      constexpr double kMax = 1e30;  // the error of an edge, squared and weighed, must stay finite
      if (!value || !(std::abs(*value) <= kMax)) {
        return Error{name + ": '" + std::string(fields[i]) + "' is no finite number" +
                     (value && std::isfinite(*value) ? " below 1e30" : "")};
      }
      values.numbers.push_back(*value);
    }
    return values;
  }

  Status take_fixed(const Fields& fields, int line) {
    if (fields.size() < 2) return Error{"FIX names no vertex"};
    for (std::size_t i = 1; i < fields.size(); ++i) {
      const Result<std::int64_t> id = read_id(fields[i]);
      if (!id) return id.error();
      fixed_.emplace(*id, line);
    }
    return {};
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
    const bool knows_to = vertices_.count(edge.to) != 0;
    if (!knows_to) vertices_.emplace(edge.from, G2oVertex{edge.from, SE3(), false});
    const auto from = vertices_.find(edge.from);
    if (!knows_to) {
      vertices_[edge.to] = {edge.to, from->second.T_world_vertex * edge.T_from_to, false};
    } else if (from == vertices_.end()) {
      const SE3& T_world_to = vertices_.at(edge.to).T_world_vertex;
      vertices_[edge.from] = {edge.from, T_world_to * edge.T_from_to.inverse(), false};
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
  for (const auto& [r, c] : information_places(is_planar)) text += number(edge.information(r, c));
  return text + "\n";
}

// --- first guess --------------------------------------------------------------------------------------------------

using SparseMatrix = Eigen::SparseMatrix<double>;
using Triplets = std::vector<Eigen::Triplet<double>>;
using Mat3X = Eigen::Matrix<double, Eigen::Dynamic, 3>;

std::size_t index(int vertex) { return static_cast<std::size_t>(vertex); }

/// Poses along the fewest edges from those that are placed already.
void grow(const std::vector<GraphEdge>& edges, std::vector<bool> placed, std::vector<SE3>* poses) {
  std::vector<std::vector<std::size_t>> edges_of(poses->size());
  for (std::size_t i = 0; i < edges.size(); ++i) {
    edges_of[index(edges[i].from)].push_back(i);
    edges_of[index(edges[i].to)].push_back(i);
  }
  std::deque<std::size_t> queue;
  for (std::size_t v = 0; v < placed.size(); ++v) {
    if (placed[v]) queue.push_back(v);
  }
  for (; !queue.empty(); queue.pop_front()) {
    const std::size_t v = queue.front();
    for (const std::size_t i : edges_of[v]) {
      const GraphEdge& edge = edges[i];
      const bool forward = index(edge.from) == v;
      const std::size_t next = index(forward ? edge.to : edge.from);
      if (placed[next]) continue;
      placed[next] = true;
      (*poses)[next] = (*poses)[v] * (forward ? edge.T_from_to : edge.T_from_to.inverse());
      queue.push_back(next);
    }
  }
}

Mat3 nearest_rotation(const Mat3& m) {
  const Eigen::JacobiSVD<Mat3> svd(m, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Vec3 signs = Vec3::Ones();
  signs(2) = (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0.0 ? -1.0 : 1.0;
  return svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
}

/// Normal equations of x_to - A^T x_from = b over blocks of `size` rows per vertex; the first vertex is known.
class BlockSystem {
 public:
  BlockSystem(std::size_t vertices, Eigen::Index size)
      : size_(size), right_(Mat3X::Zero(static_cast<Eigen::Index>(vertices - 1) * size, 3)) {}

  /// @param known value of the first vertex
  void add(const GraphEdge& edge, double weight, const Eigen::MatrixXd& A, const Mat3X& b, const Mat3X& known) {
    const Eigen::MatrixXd identity = Eigen::MatrixXd::Identity(size_, size_);
    const Eigen::MatrixXd from = -A.transpose();
    if (edge.from == 0) {
      accumulate(edge.to, identity, weight, b - from * known);
    } else if (edge.to == 0) {
      accumulate(edge.from, from, weight, b - known);
    } else {
      accumulate(edge.to, identity, weight, b);
      accumulate(edge.from, from, weight, b);
      add_block(edge.to, edge.from, weight * from);
      add_block(edge.from, edge.to, weight * from.transpose());
    }
  }

  /// @return whether there is a solution
  bool solve(Mat3X* x) const {
    SparseMatrix left(right_.rows(), right_.rows());
    left.setFromTriplets(left_.begin(), left_.end());
    const Eigen::SimplicialLDLT<SparseMatrix> solver(left);
    if (solver.info() != Eigen::Success) return false;
    *x = solver.solve(right_);
    return solver.info() == Eigen::Success && x->allFinite();
  }

 private:
  Eigen::Index row(int vertex) const { return static_cast<Eigen::Index>(vertex - 1) * size_; }

  void accumulate(int vertex, const Eigen::MatrixXd& J, double weight, const Mat3X& b) {
    add_block(vertex, vertex, weight * J.transpose() * J);
    right_.middleRows(row(vertex), size_) += weight * J.transpose() * b;
  }
  void add_block(int i, int j, const Eigen::MatrixXd& block) {
    for (Eigen::Index r = 0; r < size_; ++r) {
      for (Eigen::Index c = 0; c < size_; ++c) {
        left_.emplace_back(static_cast<int>(row(i) + r), static_cast<int>(row(j) + c), block(r, c));
      }
    }
  }

  Eigen::Index size_;
  Mat3X right_;
  Triplets left_;
};

double mean_information(const GraphEdge& edge, int first) {
  const Mat6 information = edge.sqrt_info.transpose() * edge.sqrt_info;
  return edge.weight * information.diagonal().segment<3>(first).mean();
}

/// R_to = R_from R_from_to, by rows of R transposed: R_to^T - R_from_to^T R_from^T = 0.
bool chordal_rotations(const std::vector<GraphEdge>& edges, std::vector<SE3>* poses) {
  BlockSystem system(poses->size(), 3);
  const Mat3X known = poses->front().rotation().transpose();
  for (const GraphEdge& edge : edges) {
    system.add(edge, mean_information(edge, 3), edge.T_from_to.rotation(), Mat3X::Zero(3, 3), known);
  }
  Mat3X x;
  if (!system.solve(&x)) return false;
  for (std::size_t v = 1; v < poses->size(); ++v) {
    const Mat3 transposed = x.middleRows<3>(3 * static_cast<Eigen::Index>(v - 1));
    (*poses)[v].q = Quaternion(nearest_rotation(transposed.transpose()));
  }
  return true;
}

bool linear_positions(const std::vector<GraphEdge>& edges, std::vector<SE3>* poses) {
  BlockSystem system(poses->size(), 1);
  const Eigen::MatrixXd one = Eigen::MatrixXd::Identity(1, 1);
  const Mat3X known = poses->front().t.transpose();
  for (const GraphEdge& edge : edges) {
    const Mat3X step = ((*poses)[index(edge.from)].q * edge.T_from_to.t).transpose();
    system.add(edge, mean_information(edge, 0), one, step, known);
  }
  Mat3X x;
  if (!system.solve(&x)) return false;
  for (std::size_t v = 1; v < poses->size(); ++v) (*poses)[v].t = x.row(static_cast<Eigen::Index>(v - 1));
  return true;
}

/// First guess of a connected graph. The first vertex stays where it is; the edges' loss is not used.
/// - "odometry": along the edges i -> i + 1; what they do not reach, along the fewest edges.
/// - "spanning_tree": along the fewest edges from the first vertex.
/// - "chordal": chordal relaxation (Martinec and Pajdla 2007; Carlone et al. 2015): rotations as the least-squares
///   solution over all matrices, projected onto the rotations, then the positions, which are linear. Edges count by the
///   mean of their information and by their weight. The spanning tree where a linear system cannot be solved.
std::vector<SE3> first_guess(const std::string& kind, const std::vector<GraphEdge>& edges,
                             const std::vector<SE3>& T_world_vertex) {
  std::vector<SE3> poses = T_world_vertex;
  std::vector<bool> placed(poses.size(), false);
  if (!placed.empty()) placed.front() = true;
  if (kind == "odometry") {
    std::vector<const GraphEdge*> steps(poses.size(), nullptr);  // to each vertex from the one before
    for (const GraphEdge& edge : edges) {
      if (edge.to == edge.from + 1 && steps[index(edge.to)] == nullptr) steps[index(edge.to)] = &edge;
    }
    for (std::size_t v = 1; v < poses.size() && steps[v] != nullptr; ++v) {
      poses[v] = poses[v - 1] * steps[v]->T_from_to;
      placed[v] = true;
    }
  }
  grow(edges, std::move(placed), &poses);
  if (kind != "chordal" || poses.size() < 2) return poses;
  std::vector<SE3> chordal = poses;
  return chordal_rotations(edges, &chordal) && linear_positions(edges, &chordal) ? chordal : poses;
}

// --- optimisation -------------------------------------------------------------------------------------------------

constexpr double kSpatialChi2 = 16.8, kPlanarChi2 = 11.3;  // 99 % of six and three degrees of freedom

/// Vertices that edges join, numbered from 0 in order of id.
struct Part {
  std::vector<std::size_t> vertices;  ///< indices in the file's graph
  std::vector<std::size_t> edges;
  std::vector<SE3> T_world_vertex;
  std::vector<GraphEdge> graph_edges;
  std::vector<int> fixed;
};

class GraphOptimizer {
 public:
  GraphOptimizer(const G2oGraph& graph, const GraphOptimizerOptions& options) : graph_(graph), options_(options) {
    solver_options_.error = graph.is_planar ? GraphError::kLog : GraphError::kQuaternion;
    solver_options_.loss = options.robust == "huber"    ? GraphLoss::kHuber
                           : options.robust == "cauchy" ? GraphLoss::kCauchy
                                                        : GraphLoss::kNone;
    solver_options_.loss_chi2 = graph.is_planar ? kPlanarChi2 : kSpatialChi2;
    solver_options_.max_iterations = options.max_iterations;
    solver_options_.function_tolerance = 1e-6;
    solver_options_.has_fill = true;
  }

  Result<GraphOptimizerReport> run(G2oGraph* result) {
    std::vector<Part> parts = split();
    report_.components = static_cast<int>(parts.size());
    bool has_solved_edges = false;
    for (Part& part : parts) {
      if (const Status solved = solve(&part); !solved) {
        report_.unsolved.push_back(solved.message());
      } else if (!part.edges.empty()) {
        has_solved_edges = true;
      }
    }
    if (!report_.unsolved.empty() && !has_solved_edges) return Error{report_.unsolved.front()};
    for (const Part& part : parts) {
      for (std::size_t i = 0; i < part.vertices.size(); ++i) {
        result->vertices[part.vertices[i]].T_world_vertex = part.T_world_vertex[i];
      }
    }
    return report_;
  }

 private:
  std::vector<Part> split() const {
    std::map<std::int64_t, std::size_t> index_of;
    for (std::size_t i = 0; i < graph_.vertices.size(); ++i) index_of[graph_.vertices[i].id] = i;
    boost::disjoint_sets_with_storage<> sets(graph_.vertices.size());
    for (const G2oEdge& edge : graph_.edges) sets.union_set(index_of.at(edge.from), index_of.at(edge.to));
    std::vector<Part> parts;
    std::map<std::size_t, std::size_t> part_of;  // representative to part
    std::vector<int> number(graph_.vertices.size());
    for (std::size_t i = 0; i < graph_.vertices.size(); ++i) {
      const auto [found, is_new] = part_of.emplace(sets.find_set(i), parts.size());
      if (is_new) parts.emplace_back();
      Part& part = parts[found->second];
      number[i] = static_cast<int>(part.vertices.size());
      if (graph_.vertices[i].is_fixed) part.fixed.push_back(number[i]);
      part.vertices.push_back(i);
      part.T_world_vertex.push_back(graph_.vertices[i].T_world_vertex);
    }
    for (std::size_t k = 0; k < graph_.edges.size(); ++k) {
      const G2oEdge& edge = graph_.edges[k];
      const std::size_t from = index_of.at(edge.from), to = index_of.at(edge.to);
      Part& part = parts[part_of.at(sets.find_set(from))];
      part.edges.push_back(k);
      const bool is_loop = edge.to != edge.from + 1 && edge.from != edge.to + 1;
      part.graph_edges.push_back(
          {number[from], number[to], edge.T_from_to, Mat6(edge.information.llt().matrixU()), 1.0, is_loop});
    }
    for (Part& part : parts) {
      if (part.fixed.empty()) part.fixed.push_back(0);
    }
    return parts;
  }

  /// Moved as a whole so that the first fixed vertex is where it was; the other fixed ones are put back.
  std::vector<SE3> guess(const Part& part, const std::string& initial) const {
    if (initial == "file") return part.T_world_vertex;
    std::vector<SE3> guess = first_guess(initial, part.graph_edges, part.T_world_vertex);
    const std::size_t anchor = index(part.fixed.front());
    const SE3 T = part.T_world_vertex[anchor] * guess[anchor].inverse();
    for (SE3& T_world_vertex : guess) T_world_vertex = T * T_world_vertex;
    for (const int v : part.fixed) guess[index(v)] = part.T_world_vertex[index(v)];
    return guess;
  }

  Status solve(Part* part) {
    solver_options_.fixed = part->fixed;
    const std::vector<SE3> asked = guess(*part, options_.initial);
    std::vector<const G2oEdge*> outliers;
    if (options_.robust == "gnc") {
      if (const Status rejected = reject_outliers(asked, part, &outliers); !rejected) return rejected;
    }
    std::vector<SE3> best = options_.initial == "chordal" ? asked : guess(*part, "chordal");
    const auto chi2 = [&](const std::vector<SE3>& poses) {
      double cost = 0.0, chi2 = 0.0;
      add_costs(*part, poses, &cost, &chi2);
      return chi2;
    };
    // A guess that is worse than the chordal one to begin with has nothing to offer.
    const bool tries_asked = options_.initial != "chordal" && chi2(asked) < chi2(best);
    GraphSolution solution = solve_graph(part->graph_edges, solver_options_, &best);
    report_.iterations += solution.iterations;
    if (tries_asked) {
      std::vector<SE3> poses = asked;
      const GraphSolution other = solve_graph(part->graph_edges, solver_options_, &poses);
      report_.iterations += other.iterations;
      if (other.usable && (!solution.usable || other.final_cost <= solution.final_cost)) {
        best = std::move(poses);
        solution = other;
      }
    }
    if (!solution.usable) {
      return Error{"the part of vertex " + std::to_string(graph_.vertices[part->vertices.front()].id) +
                   " cannot be solved: " + solution.message};
    }
    part->T_world_vertex = std::move(best);
    report_.outliers.insert(report_.outliers.end(), outliers.begin(), outliers.end());
    add_costs(*part, asked, &report_.initial_cost, &report_.initial_chi2);
    add_costs(*part, part->T_world_vertex, &report_.final_cost, &report_.final_chi2);
    return {};
  }

  /// Gives the outliers weight 0.
  Status reject_outliers(const std::vector<SE3>& start, Part* part, std::vector<const G2oEdge*>* outliers) const {
    GraphSolverOptions options = solver_options_;
    options.loss = GraphLoss::kNone;
    const LoopClassification classes = classify_loops(part->graph_edges, options.loss_chi2, options, start);
    if (!classes.usable) {
      return Error{"the edges of the part of vertex " + std::to_string(graph_.vertices[part->vertices.front()].id) +
                   " cannot be classified"};
    }
    std::size_t loop = 0;
    for (std::size_t k = 0; k < part->graph_edges.size(); ++k) {
      GraphEdge& edge = part->graph_edges[k];
      if (!edge.robust || classes.kept[loop++]) continue;
      edge.weight = 0.0;
      outliers->push_back(&graph_.edges[part->edges[k]]);
    }
    return {};
  }

  void add_costs(const Part& part, const std::vector<SE3>& poses, double* cost, double* chi2) const {
    for (const GraphEdge& edge : part.graph_edges) {
      *cost += 0.5 * edge.weight * chi_squared(edge, poses);
      *chi2 += edge.weight * chi_squared(edge, poses, solver_options_.error);
    }
  }

  const G2oGraph& graph_;
  const GraphOptimizerOptions& options_;
  GraphSolverOptions solver_options_;
  GraphOptimizerReport report_;
};

}  // namespace

Result<G2oGraph> read_g2o(const std::string& path, G2oRefusals* refusals) { return Reader(path, refusals).read(); }

Status write_g2o(const std::string& path, const G2oGraph& graph) {
  std::string text;
  for (const G2oVertex& vertex : graph.vertices) {
    text += (graph.is_planar ? "VERTEX_SE2 " : "VERTEX_SE3:QUAT ") + std::to_string(vertex.id) +
            format_pose(vertex.T_world_vertex, graph.is_planar) + "\n";
    if (vertex.is_fixed) text += "FIX " + std::to_string(vertex.id) + "\n";
  }
  for (const G2oEdge& edge : graph.edges) text += format_edge(edge, graph.is_planar);
  return write_text_file(path, text);
}

Result<GraphOptimizerReport> optimize_graph(G2oGraph* graph, const GraphOptimizerOptions& options) {
  if (const Status valid = validate(options); !valid) return valid.error();
  return GraphOptimizer(*graph, options).run(graph);
}

}  // namespace semantic_topo_loop::core
