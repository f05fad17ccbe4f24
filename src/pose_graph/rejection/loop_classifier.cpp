#include "pose_graph/rejection/loop_classifier.h"

#include <algorithm>
#include <cmath>

namespace semantic_topo_loop::core {
namespace {

constexpr double kMuGrowth = 1.6;
constexpr int kMaxRounds = 40;
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
    constexpr int kAttempts = 3;
    const std::size_t tolerated = 2 + loops_.size() / 20;
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
