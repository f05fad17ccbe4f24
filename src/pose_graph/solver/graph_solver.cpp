#include "pose_graph/solver/graph_solver.h"

#include <algorithm>
#include <cmath>

#include "geometry/ceres_compat.h"
#include "geometry/relative_pose.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

/// A vertex of a graph over similarities as Ceres holds it; that of a graph over poses is its SE3.
struct ScaledVertex {
  SE3 T;
  double log_scale;
};

std::vector<double*> blocks_of(SE3* T) { return {T->t.data(), T->q.coeffs().data()}; }
std::vector<double*> blocks_of(ScaledVertex* vertex) {
  return {vertex->T.t.data(), vertex->T.q.coeffs().data(), &vertex->log_scale};
}

void read(double const* const* blocks, SE3* T) { *T = SE3(Quaternion(blocks[1]), Vec3(blocks[0])); }
void read(double const* const* blocks, Sim3* S) {
  read(blocks, &S->T);
  S->scale = std::exp(*blocks[2]);
}

Vec6 residual(const SE3& T_world_from, const SE3& T_world_to, const SE3& T_from_to, GraphError error) {
  return error == GraphError::kLog ? relative_pose_residual(T_world_from, T_world_to, T_from_to)
                                   : quaternion_pose_terms(T_world_from, T_world_to, T_from_to).residual;
}
Vec7 residual(const Sim3& S_world_from, const Sim3& S_world_to, const Sim3& S_from_to, GraphError) {
  return relative_similarity_terms(S_world_from, S_world_to, S_from_to).residual;
}

RelativePoseTerms terms(const SE3& T_world_from, const SE3& T_world_to, const SE3& T_from_to, GraphError error) {
  return error == GraphError::kLog ? relative_pose_terms(T_world_from, T_world_to, T_from_to)
                                   : quaternion_pose_terms(T_world_from, T_world_to, T_from_to);
}
RelativeSimilarityTerms terms(const Sim3& S_world_from, const Sim3& S_world_to, const Sim3& S_from_to, GraphError) {
  return relative_similarity_terms(S_world_from, S_world_to, S_from_to);
}

/// sqrt(w) U e over the blocks of from and to.
template <class Transform, int n>
class RelativeCost final : public ceres::CostFunction {
 public:
  using Matrix = Eigen::Matrix<double, n, n>;

  RelativeCost(const Transform& from_to, const Matrix& sqrt_info, double weight, GraphError error)
      : error_(error), from_to_(from_to), sqrt_info_(std::sqrt(weight) * sqrt_info) {
    set_num_residuals(n);
    for (const int size : {3, 4, 1, 3, 4, 1}) {
      if (size > 1 || n == 7) mutable_parameter_block_sizes()->push_back(size);
    }
  }

  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    constexpr int kBlocks = n - 4;  // of a vertex
    Transform from, to;
    read(blocks, &from);
    read(blocks + kBlocks, &to);
    Eigen::Map<Eigen::Matrix<double, n, 1>> e(residuals);
    if (jacobians == nullptr) {
      e = sqrt_info_ * residual(from, to, from_to_, error_);
      return true;
    }
    const RelativeTerms<n> terms = semantic_topo_loop::core::terms(from, to, from_to_, error_);
    e = sqrt_info_ * terms.residual;
    write(sqrt_info_ * terms.J_from, Quaternion(blocks[1]), jacobians);
    write(sqrt_info_ * terms.J_to, Quaternion(blocks[kBlocks + 1]), jacobians + kBlocks);
    return true;
  }

 private:
  template <int m>
  using Columns = Eigen::Map<Eigen::Matrix<double, n, m, m == 1 ? Eigen::ColMajor : Eigen::RowMajor>>;

  /// The columns of P = quaternion_by_rotation are orthonormal and the rotation is twice the tangent, so 2 J P^T is a
  /// derivative by the quaternion that its manifold projects back to the derivative by the rotation.
  static void write(const Matrix& J, const Quaternion& q, double** jacobians) {
    if (jacobians[0] != nullptr) Columns<3>{jacobians[0]} = J.template leftCols<3>();
    if (jacobians[1] != nullptr) {
      Columns<4>{jacobians[1]} = 2.0 * J.template middleCols<3>(3) * quaternion_by_rotation(q).transpose();
    }
    if constexpr (n == 7) {
      if (jacobians[2] != nullptr) Columns<1>{jacobians[2]} = J.col(6);
    }
  }

  GraphError error_;
  Transform from_to_;
  Matrix sqrt_info_;
};

ceres::LossFunction* make_loss(const GraphSolverOptions& options) {
  const double scale = std::sqrt(options.loss_chi2);
  if (options.loss == GraphLoss::kHuber) return new ceres::HuberLoss(scale);
  return options.loss == GraphLoss::kCauchy ? new ceres::CauchyLoss(scale) : nullptr;
}

template <class Vertex>
void add_vertices(const std::vector<int>& fixed, std::vector<Vertex>* vertices, ceres::Problem* problem) {
  for (Vertex& vertex : *vertices) {
    const std::vector<double*> blocks = blocks_of(&vertex);
    problem->AddParameterBlock(blocks[0], 3);
    problem->AddParameterBlock(blocks[1], 4);
    set_quaternion_manifold(*problem, blocks[1]);
    if (blocks.size() > 2) problem->AddParameterBlock(blocks[2], 1);
  }
  for (const int v : fixed) {
    for (double* block : blocks_of(&(*vertices)[static_cast<std::size_t>(v)]))
      problem->SetParameterBlockConstant(block);
  }
}

template <class Vertex>
std::vector<double*> blocks_of(int from, int to, std::vector<Vertex>* vertices) {
  std::vector<double*> blocks = blocks_of(&(*vertices)[static_cast<std::size_t>(from)]);
  for (double* block : blocks_of(&(*vertices)[static_cast<std::size_t>(to)])) blocks.push_back(block);
  return blocks;
}

template <class Vertex>
bool all_finite(const std::vector<Vertex>& vertices) {
  return std::all_of(vertices.begin(), vertices.end(), [](const Vertex& vertex) { return vertex.is_finite(); });
}

/// @return the first fault that would make every residual meaningless, or an empty text
template <class Edge, class Vertex>
std::string graph_fault(const std::vector<Edge>& edges, const std::vector<int>& fixed,
                        const std::vector<Vertex>& vertices) {
  const auto is_known = [n = static_cast<int>(vertices.size())](int v) { return v >= 0 && v < n; };
  if (vertices.empty()) return "no vertex";
  if (fixed.empty()) return "no vertex is fixed";
  if (!all_finite(vertices)) return "a vertex is not finite";
  if (!std::all_of(fixed.begin(), fixed.end(), is_known)) return "a fixed vertex is unknown";
  for (const Edge& edge : edges) {
    const bool is_joined = is_known(edge.from) && is_known(edge.to) && edge.from != edge.to;
    if (is_joined && edge.is_finite() && edge.sqrt_info.allFinite() && edge.weight >= 0.0) continue;
    return "edge " + std::to_string(edge.from) + " to " + std::to_string(edge.to) +
           " is not finite or joins no two vertices";
  }
  return {};
}

/// Takes over a solution; not even the rounding of the fixed vertices changes.
template <class Vertex>
void accept(std::vector<Vertex> result, const std::vector<int>& fixed, std::vector<Vertex>* vertices) {
  for (const int v : fixed) result[static_cast<std::size_t>(v)] = (*vertices)[static_cast<std::size_t>(v)];
  *vertices = std::move(result);
}

/// @return with the message of Ceres; usable as far as Ceres can tell
GraphSolution solve_problem(const GraphSolverOptions& options, ceres::Problem* problem) {
  ceres::Solver::Options ceres_options;
  ceres_options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  ceres_options.num_threads = 1;
  // SuiteSparse starts threads of its own, to no use for a chain with some loops.
  if (!options.has_fill && ceres::IsSparseLinearAlgebraLibraryTypeAvailable(ceres::EIGEN_SPARSE)) {
    ceres_options.sparse_linear_algebra_library_type = ceres::EIGEN_SPARSE;
  }
  ceres_options.max_num_iterations = options.max_iterations;
  ceres_options.function_tolerance = options.function_tolerance;
  ceres_options.max_solver_time_in_seconds = 1e9;
  ceres_options.initial_trust_region_radius = 1e13;  // nearly Gauss-Newton: the start is good, or the solver backs off
  ceres_options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(ceres_options, problem, &summary);
  GraphSolution solution;
  solution.usable = summary.IsSolutionUsable();
  solution.converged = summary.termination_type == ceres::CONVERGENCE;
  solution.initial_cost = summary.initial_cost;
  solution.final_cost = summary.final_cost;
  solution.iterations = static_cast<int>(summary.iterations.size());
  solution.message = summary.message;
  return solution;
}

}  // namespace

GraphSolution solve_graph(const std::vector<GraphEdge>& edges, const GraphSolverOptions& options,
                          std::vector<SE3>* T_world_vertex, const GraphObjects& objects) {
  GraphSolution solution;
  solution.message = graph_fault(edges, options.fixed, *T_world_vertex);
  if (!solution.message.empty()) return solution;
  std::vector<SE3> vertices = *T_world_vertex;
  for (SE3& T : vertices) T.q.normalize();
  ceres::Problem problem;
  add_vertices(options.fixed, &vertices, &problem);
  for (const GraphEdge& edge : edges) {
    if (edge.weight <= 0.0) continue;
    problem.AddResidualBlock(new RelativeCost<SE3, 6>(edge.T_from_to, edge.sqrt_info, edge.weight, options.error),
                             edge.robust ? make_loss(options) : nullptr, blocks_of(edge.from, edge.to, &vertices));
  }
  const ObjectBlocks object_blocks(objects, &vertices, &problem);
  solution = solve_problem(options, &problem);
  solution.usable = solution.usable && all_finite(vertices);
  if (!solution.usable) return solution;
  for (SE3& T : vertices) T.q.normalize();
  accept(std::move(vertices), options.fixed, T_world_vertex);
  return solution;
}

GraphSolution solve_similarity_graph(const std::vector<SimilarityEdge>& edges, const GraphSolverOptions& options,
                                     std::vector<Sim3>* S_world_vertex) {
  GraphSolution solution;
  solution.message = graph_fault(edges, options.fixed, *S_world_vertex);
  if (!solution.message.empty()) return solution;
  std::vector<ScaledVertex> vertices;
  for (const Sim3& S : *S_world_vertex) vertices.push_back({SE3(S.T.q.normalized(), S.T.t), std::log(S.scale)});
  ceres::Problem problem;
  add_vertices(options.fixed, &vertices, &problem);
  for (const SimilarityEdge& edge : edges) {
    if (edge.weight <= 0.0) continue;
    problem.AddResidualBlock(new RelativeCost<Sim3, 7>(edge.S_from_to, edge.sqrt_info, edge.weight, options.error),
                             nullptr, blocks_of(edge.from, edge.to, &vertices));
  }
  solution = solve_problem(options, &problem);
  std::vector<Sim3> result;
  result.reserve(vertices.size());
  for (const ScaledVertex& v : vertices) result.emplace_back(SE3(v.T.q.normalized(), v.T.t), std::exp(v.log_scale));
  solution.usable = solution.usable && all_finite(result);
  if (solution.usable) accept(std::move(result), options.fixed, S_world_vertex);
  return solution;
}

double chi_squared(const GraphEdge& edge, const std::vector<SE3>& T_world_vertex, GraphError error) {
  const Vec6 e = residual(T_world_vertex[static_cast<std::size_t>(edge.from)],
                          T_world_vertex[static_cast<std::size_t>(edge.to)], edge.T_from_to, error);
  return (edge.sqrt_info * e).squaredNorm();
}

namespace {

constexpr double kMuGrowth = 1.6;  // of the control parameter a round; Yang et al. take 1.4 and a full solve in each
constexpr int kMaxRounds = 40;     // grow it by 1.6^40 = 1e8: from where no loop is doubted to where each is in or out
constexpr int kRoundIterations = 3;  // each round starts at the solution of the one before

/// Weight of truncated least squares at control parameter mu: 1 for small errors, 0 for large ones, between them the
/// minimiser of w r^2 + mu (1 - w) / (mu + w) chi2.
double truncated_weight(double r2, double chi2, double mu) {
  if (r2 <= mu / (mu + 1.0) * chi2) return 1.0;
  if (r2 >= (mu + 1.0) / mu * chi2) return 0.0;
  return std::clamp(std::sqrt(chi2 * mu * (mu + 1.0) / r2) - mu, 0.0, 1.0);
}

class GraduatedNonConvexity {
 public:
  GraduatedNonConvexity(const std::vector<GraphEdge>& edges, double chi2, const GraphSolverOptions& options,
                        const std::vector<SE3>& T_world_vertex)
      : edges_(edges), chi2_(chi2), options_(options) {
    result_.T_world_vertex = T_world_vertex;
    for (std::size_t i = 0; i < edges.size(); ++i) {
      if (!edges[i].robust) continue;
      loops_.push_back(i);
      base_weights_.push_back(edges[i].weight);
    }
  }

  LoopClassification run(const std::vector<bool>& guess) {
    if (!guess.empty() && confirm(guess)) {
      result_.usable = true;
      return result_;
    }
    for (std::size_t k = 0; k < loops_.size(); ++k) edges_[loops_[k]].weight = base_weights_[k];
    if (!solve()) return result_;
    double worst = 0.0;
    for (const std::size_t i : loops_)
      worst = std::max(worst, chi_squared(edges_[i], result_.T_world_vertex, options_.error));
    double mu = chi2_ / std::max(2.0 * worst - chi2_, 1e-9);
    for (int round = 0; round < kMaxRounds && worst > chi2_; ++round, mu *= kMuGrowth) {
      const bool decided = reweigh(mu);
      if (!solve_round()) return result_;
      if (decided) break;
    }
    result_.usable = true;
    judge();
    return result_;
  }

 private:
  /// Solves with the guessed loops; a few of them may turn out false, or others right.
  bool confirm(std::vector<bool> guess) {
    constexpr int kAttempts = 3;  // together cheaper than judging all anew, which takes some ten solves
    const std::size_t tolerated = 2 + loops_.size() / 20;  // changes: a few, or one loop in twenty
    for (int attempt = 0; attempt < kAttempts; ++attempt) {
      for (std::size_t k = 0; k < loops_.size(); ++k) edges_[loops_[k]].weight = guess[k] ? base_weights_[k] : 0.0;
      if (!solve()) return false;
      judge();
      std::size_t changed = 0;
      for (std::size_t k = 0; k < guess.size(); ++k) changed += guess[k] != result_.kept[k] ? 1 : 0;
      if (changed == 0) return true;
      if (changed > tolerated) return false;
      guess = result_.kept;
    }
    return false;
  }

  void judge() {
    result_.kept.clear();
    for (const std::size_t i : loops_)
      result_.kept.push_back(chi_squared(edges_[i], result_.T_world_vertex, options_.error) <= chi2_);
  }
  bool solve() { return solve_graph(edges_, options_, &result_.T_world_vertex).usable; }
  /// A few iterations, or as many as it takes where these were lost on steps that led uphill.
  bool solve_round() {
    GraphSolverOptions few = options_;
    few.max_iterations = std::min(options_.max_iterations, kRoundIterations);
    const GraphSolution solution = solve_graph(edges_, few, &result_.T_world_vertex);
    const bool is_stuck = !solution.converged && solution.final_cost >= solution.initial_cost;
    return is_stuck ? solve() : solution.usable;
  }
  /// @return whether every loop is in or out
  bool reweigh(double mu) {
    bool decided = true;
    for (std::size_t k = 0; k < loops_.size(); ++k) {
      GraphEdge& edge = edges_[loops_[k]];
      const double weight = truncated_weight(chi_squared(edge, result_.T_world_vertex, options_.error), chi2_, mu);
      decided = decided && (weight < 1e-3 || weight > 0.999);
      edge.weight = weight * base_weights_[k];
    }
    return decided;
  }

  std::vector<GraphEdge> edges_;
  std::vector<std::size_t> loops_;
  std::vector<double> base_weights_;
  double chi2_;
  GraphSolverOptions options_;
  LoopClassification result_;
};

}  // namespace

LoopClassification classify_loops(const std::vector<GraphEdge>& edges, double chi2, const GraphSolverOptions& options,
                                  const std::vector<SE3>& T_world_vertex, const std::vector<bool>& guess) {
  return GraduatedNonConvexity(edges, chi2, options, T_world_vertex).run(guess);
}

}  // namespace semantic_topo_loop::core
