#include "pose_graph/solver/graph_solver.h"

#include <algorithm>
#include <cmath>

#include "geometry/ceres_compat.h"
#include "geometry/relative_pose.h"
#include "pose_graph/solver/graph_problem.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

using RowMat63 = Eigen::Matrix<double, 6, 3, Eigen::RowMajor>;
using RowMat64 = Eigen::Matrix<double, 6, 4, Eigen::RowMajor>;

Vec6 residual(const SE3& T_world_from, const SE3& T_world_to, const SE3& T_from_to, GraphError error) {
  return error == GraphError::kLog ? relative_pose_residual(T_world_from, T_world_to, T_from_to)
                                   : quaternion_pose_residual(T_world_from, T_world_to, T_from_to);
}

/// sqrt(w) U e(T_z^-1 T_from^-1 T_to) over (t_from, q_from, t_to, q_to).
class RelativePoseCost : public ceres::SizedCostFunction<6, 3, 4, 3, 4> {
 public:
  RelativePoseCost(const GraphEdge& edge, GraphError error)
      : error_(error), T_from_to_(edge.T_from_to), sqrt_info_(std::sqrt(edge.weight) * edge.sqrt_info) {}

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const SE3 T_world_from{Quaternion(parameters[1]), Vec3(parameters[0])};
    const SE3 T_world_to{Quaternion(parameters[3]), Vec3(parameters[2])};
    Eigen::Map<Vec6> e(residuals);
    if (jacobians == nullptr) {
      e = sqrt_info_ * residual(T_world_from, T_world_to, T_from_to_, error_);
      return true;
    }
    const RelativePoseTerms terms = error_ == GraphError::kLog
                                        ? relative_pose_terms(T_world_from, T_world_to, T_from_to_)
                                        : quaternion_pose_terms(T_world_from, T_world_to, T_from_to_);
    e = sqrt_info_ * terms.residual;
    write(sqrt_info_ * terms.J_from, T_world_from.q, jacobians[0], jacobians[1]);
    write(sqrt_info_ * terms.J_to, T_world_to.q, jacobians[2], jacobians[3]);
    return true;
  }

 private:
  /// The columns of P = quaternion_by_rotation are orthonormal and the rotation is twice the tangent, so 2 J P^T is a
  /// derivative by the quaternion that its manifold projects back to the derivative by the rotation.
  static void write(const Mat6& J, const Quaternion& q, double* by_translation, double* by_quaternion) {
    if (by_translation != nullptr) Eigen::Map<RowMat63>{by_translation} = J.leftCols<3>();
    if (by_quaternion != nullptr) {
      Eigen::Map<RowMat64>{by_quaternion} = 2.0 * J.rightCols<3>() * quaternion_by_rotation(q).transpose();
    }
  }

  GraphError error_;
  SE3 T_from_to_;
  Mat6 sqrt_info_;
};

ceres::LossFunction* make_loss(const GraphSolverOptions& options) {
  const double scale = std::sqrt(options.loss_chi2);
  switch (options.loss) {
    case GraphLoss::kHuber:
      return new ceres::HuberLoss(scale);
    case GraphLoss::kCauchy:
      return new ceres::CauchyLoss(scale);
    case GraphLoss::kNone:
      break;
  }
  return nullptr;
}

void add_vertices(const std::vector<int>& fixed, std::vector<SE3>* vertices, ceres::Problem* problem) {
  for (SE3& T : *vertices) {
    problem->AddParameterBlock(T.t.data(), 3);
    problem->AddParameterBlock(T.q.coeffs().data(), 4);
    set_quaternion_manifold(*problem, T.q.coeffs().data());
  }
  for (const int v : fixed) {
    SE3& T = (*vertices)[static_cast<std::size_t>(v)];
    problem->SetParameterBlockConstant(T.t.data());
    problem->SetParameterBlockConstant(T.q.coeffs().data());
  }
}

}  // namespace

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
    SE3& from = vertices[static_cast<std::size_t>(edge.from)];
    SE3& to = vertices[static_cast<std::size_t>(edge.to)];
    problem.AddResidualBlock(new RelativePoseCost(edge, options.error), edge.robust ? make_loss(options) : nullptr,
                             from.t.data(), from.q.coeffs().data(), to.t.data(), to.q.coeffs().data());
  }
  const ObjectBlocks object_blocks(objects, &vertices, &problem);
  solution = solve_problem(options, &problem);
  solution.usable = solution.usable && all_finite(vertices);
  if (!solution.usable) return solution;
  for (SE3& T : vertices) T.q.normalize();
  accept(std::move(vertices), options.fixed, T_world_vertex);
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
  bool solve() {
    ++result_.solves;
    return solve_graph(edges_, options_, &result_.T_world_vertex).usable;
  }
  /// A few iterations, or as many as it takes where these were lost on steps that led uphill.
  bool solve_round() {
    GraphSolverOptions few = options_;
    few.max_iterations = std::min(options_.max_iterations, kRoundIterations);
    ++result_.solves;
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
