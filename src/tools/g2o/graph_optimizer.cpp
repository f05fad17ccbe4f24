#include "tools/g2o/graph_optimizer.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <map>
#include <numeric>

#include "pose_graph/solver/graph_solver.h"
#include "tools/g2o/graph_initialisation.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kSpatialChi2 = 16.8, kPlanarChi2 = 11.3;  // 99 % of six and three degrees of freedom

/// Vertices that edges join, numbered from 0 in order of id.
struct Part {
  std::vector<std::size_t> vertices;  ///< indices in the file's graph
  std::vector<std::size_t> edges;
  std::vector<SE3> T_world_vertex;
  std::vector<GraphEdge> graph_edges;
  std::vector<int> fixed;
};

/// Representatives of a forest of merged sets.
class DisjointSets {
 public:
  explicit DisjointSets(std::size_t size) : parent_(size) { std::iota(parent_.begin(), parent_.end(), 0U); }
  std::size_t find(std::size_t i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void join(std::size_t a, std::size_t b) {
    const std::size_t first = std::min(find(a), find(b)), second = std::max(find(a), find(b));
    parent_[second] = first;
  }

 private:
  std::vector<std::size_t> parent_;
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

  bool run(G2oGraph* result, GraphOptimizerReport* report, std::string* error) {
    report_ = GraphOptimizerReport();
    std::vector<Part> parts = split();
    report_.components = static_cast<int>(parts.size());
    bool has_solved_edges = false;
    for (Part& part : parts) {
      std::string problem;
      if (!solve(&part, &problem)) {
        report_.unsolved.push_back(problem);
      } else if (!part.edges.empty()) {
        has_solved_edges = true;
      }
    }
    if (!report_.unsolved.empty() && !has_solved_edges) {
      *error = report_.unsolved.front();
      return false;
    }
    for (const Part& part : parts) {
      for (std::size_t i = 0; i < part.vertices.size(); ++i) {
        result->vertices[part.vertices[i]].T_world_vertex = part.T_world_vertex[i];
      }
    }
    *report = report_;
    return true;
  }

 private:
  std::vector<Part> split() const {
    std::map<std::int64_t, std::size_t> index_of;
    for (std::size_t i = 0; i < graph_.vertices.size(); ++i) index_of[graph_.vertices[i].id] = i;
    DisjointSets sets(graph_.vertices.size());
    for (const G2oEdge& edge : graph_.edges) sets.join(index_of.at(edge.from), index_of.at(edge.to));
    std::vector<Part> parts;
    std::map<std::size_t, std::size_t> part_of;  // representative to part
    std::vector<int> number(graph_.vertices.size());
    for (std::size_t i = 0; i < graph_.vertices.size(); ++i) {
      const auto [found, is_new] = part_of.emplace(sets.find(i), parts.size());
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
      Part& part = parts[part_of.at(sets.find(from))];
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
  static std::vector<SE3> anchored(std::vector<SE3> guess, const Part& part) {
    const auto at = [](int v) { return static_cast<std::size_t>(v); };
    const SE3 T = part.T_world_vertex[at(part.fixed.front())] * guess[at(part.fixed.front())].inverse();
    for (SE3& T_world_vertex : guess) T_world_vertex = T * T_world_vertex;
    for (const int v : part.fixed) guess[at(v)] = part.T_world_vertex[at(v)];
    return guess;
  }

  std::vector<SE3> guess(const Part& part, const std::string& initial) const {
    if (initial == "odometry") return anchored(odometry_guess(part.graph_edges, part.T_world_vertex), part);
    if (initial == "spanning_tree") return anchored(spanning_tree_guess(part.graph_edges, part.T_world_vertex), part);
    if (initial == "chordal") return anchored(chordal_guess(part.graph_edges, part.T_world_vertex), part);
    return part.T_world_vertex;
  }

  bool solve(Part* part, std::string* error) {
    solver_options_.fixed = part->fixed;
    const std::vector<SE3> asked = guess(*part, options_.initial);
    std::vector<const G2oEdge*> outliers;
    if (options_.robust == "gnc" && !reject_outliers(asked, part, &outliers, error)) return false;
    std::vector<SE3> best = options_.initial == "chordal" ? asked : guess(*part, "chordal");
    // A guess that is worse than the chordal one to begin with has nothing to offer.
    const bool tries_asked = options_.initial != "chordal" && chi2(*part, asked) < chi2(*part, best);
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
      *error = "the part of vertex " + std::to_string(graph_.vertices[part->vertices.front()].id) +
               " cannot be solved: " + solution.message;
      return false;
    }
    part->T_world_vertex = std::move(best);
    report_.outliers.insert(report_.outliers.end(), outliers.begin(), outliers.end());
    add_costs(*part, asked, &report_.initial_cost, &report_.initial_chi2);
    add_costs(*part, part->T_world_vertex, &report_.final_cost, &report_.final_chi2);
    return true;
  }

  /// Gives the outliers weight 0.
  bool reject_outliers(const std::vector<SE3>& start, Part* part, std::vector<const G2oEdge*>* outliers,
                       std::string* error) const {
    GraphSolverOptions options = solver_options_;
    options.loss = GraphLoss::kNone;
    const LoopClassification classes = classify_loops(part->graph_edges, options.loss_chi2, options, start);
    if (!classes.usable) {
      *error = "the edges of the part of vertex " + std::to_string(graph_.vertices[part->vertices.front()].id) +
               " cannot be classified";
      return false;
    }
    std::size_t loop = 0;
    for (std::size_t k = 0; k < part->graph_edges.size(); ++k) {
      GraphEdge& edge = part->graph_edges[k];
      if (!edge.robust || classes.kept[loop++]) continue;
      edge.weight = 0.0;
      outliers->push_back(&graph_.edges[part->edges[k]]);
    }
    return true;
  }

  double chi2(const Part& part, const std::vector<SE3>& poses) const {
    double cost = 0.0, chi2 = 0.0;
    add_costs(part, poses, &cost, &chi2);
    return chi2;
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

bool optimize_graph(G2oGraph* graph, const GraphOptimizerOptions& options, GraphOptimizerReport* report,
                    std::string* error) {
  const Status status = validate(options);
  std::string problem = status.message();
  const bool is_solved = status && GraphOptimizer(*graph, options).run(graph, report, &problem);
  if (!is_solved && error != nullptr) *error = problem;
  return is_solved;
}

}  // namespace semantic_topo_loop::core
