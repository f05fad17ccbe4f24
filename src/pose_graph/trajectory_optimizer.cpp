#include "semantic_topo_loop/pose_graph/trajectory_optimizer.h"

#include <algorithm>

#include "semantic_topo_loop/pose_graph/loop_classifier.h"
#include "semantic_topo_loop/pose_graph/relative_pose.h"

namespace semantic_topo_loop::core {
namespace {

GraphLoss loss_of(const std::string& robust) {
  if (robust == "huber") return GraphLoss::kHuber;
  return robust == "cauchy" ? GraphLoss::kCauchy : GraphLoss::kNone;
}

OdometryNoise scaled(const OdometryNoise& noise, double factor) {
  return {noise.translation_m * factor, noise.rotation_rad * factor};
}

/// At most `count` loops, evenly taken from their order of acceptance.
std::vector<GraphLoop> thinned(const std::vector<GraphLoop>& loops, std::size_t count) {
  if (loops.size() <= count) return loops;
  std::vector<GraphLoop> some;
  for (std::size_t i = 0; i < count; ++i) some.push_back(loops[i * loops.size() / count]);
  return some;
}

Mat6 jump_covariance(const OdometryJump& jump) {
  Vec6 sigmas;
  sigmas << Vec3::Constant(jump.translation_m), Vec3::Constant(jump.rotation_rad);
  return sigmas.cwiseAbs2().asDiagonal();
}

class TrajectoryOptimizer {
 public:
  TrajectoryOptimizer(const Trajectory& trajectory, const PoseGraphOptions& options, const GraphKnowledge& knowledge,
                      Effort effort)
      : trajectory_(trajectory), options_(options), effort_(effort), redundancy_(redundancy(trajectory.loops)) {
    result_.T_map_vertex = trajectory.T_map_vertex;
    result_.knowledge = knowledge;
    solver_options_.loss = loss_of(options.robust);
    solver_options_.loss_chi2 = options.robust_chi2;
    solver_options_.max_iterations = options.max_iterations;
  }

  OptimizedTrajectory run() {
    if (!classify()) return result_;
    if (options_.estimate_noise) learn_noise();
    result_.usable = solve();
    return result_;
  }

 private:
  bool classify() {
    std::vector<bool>& kept = result_.knowledge.kept;
    kept.resize(trajectory_.loops.size(), true);
    if (options_.robust == "none") return true;
    for (std::size_t k = 0; k < kept.size(); ++k) kept[k] = kept[k] && has_vote(k);
    find_loose_factor();
    const GraphKnowledge& known = result_.knowledge;
    const std::vector<GraphEdge> edges =
        graph({scaled(noise_prior(options_).least, known.loose_factor), 1.0, known.noise.jumps}, false);
    if (options_.robust != "gnc") {
      if (!report(solve_graph(edges, solver_options_, &result_.T_map_vertex))) return false;
      for (std::size_t k = 0; k < kept.size(); ++k) {
        kept[k] = has_vote(k) &&
                  chi_squared(edges[trajectory_.edges.size() + k], result_.T_map_vertex) <= options_.robust_chi2;
      }
      return true;
    }
    std::vector<bool> guess;
    for (std::size_t k = 0; k < kept.size() && effort_ != Effort::kFull; ++k) {
      if (has_vote(k)) guess.push_back(kept[k]);
    }
    const LoopClassification classes =
        classify_loops(edges, options_.robust_chi2, solver_options_, result_.T_map_vertex, guess);
    if (!classes.usable) {
      result_.message = "the loops could not be classified";
      return false;
    }
    std::size_t voter = 0;
    for (std::size_t k = 0; k < kept.size(); ++k) kept[k] = has_vote(k) && classes.kept[voter++];
    result_.T_map_vertex = classes.T_world_vertex;
    return true;
  }

  bool has_vote(std::size_t loop) const { return trajectory_.votes.empty() || trajectory_.votes[loop]; }

  void find_loose_factor() {
    double& factor = result_.knowledge.loose_factor;
    if (factor > 0.0 && effort_ == Effort::kUpdate) return;
    constexpr double kLeastFactor = 10.0;  // 1 cm after one metre: less room is of no use to right loops
    factor = kLeastFactor;
    if (!options_.estimate_noise) return;
    constexpr std::size_t kMaxLoops = 60;
    std::vector<GraphLoop> voters;
    for (std::size_t k = 0; k < trajectory_.loops.size(); ++k) {
      if (has_vote(k)) voters.push_back(trajectory_.loops[k]);
    }
    const std::vector<GraphLoop> some = thinned(voters, kMaxLoops);
    const InnovationModel model(result_.T_map_vertex, trajectory_.edges, some);
    factor =
        std::max(factor, options_.gnc_loosening * robust_noise_factor(model, noise_prior(options_), redundancy(some)));
  }

  void learn_noise() {
    constexpr std::size_t kMaxLoops = 24;  // as many as can be afforded: the cost grows with their cube
    std::vector<GraphLoop> loops;
    for (std::size_t k = 0; k < trajectory_.loops.size(); ++k) {
      if (result_.knowledge.kept[k]) loops.push_back(trajectory_.loops[k]);
    }
    const std::vector<GraphLoop> some = thinned(loops, kMaxLoops);
    InnovationModel model(result_.T_map_vertex, trajectory_.edges, some);
    NoiseEstimate& noise = result_.knowledge.noise;
    constexpr int kMaxNewJumps = 2;
    if (effort_ != Effort::kUpdate) {
      noise = estimate_noise_and_jumps(&model, noise_prior(options_), noise, kMaxNewJumps);
    }
    model.set_jumps(noise.jumps);
    steady_errors_ = model.steady_errors(noise);
  }

  bool solve() {
    const bool has_loss = solver_options_.loss != GraphLoss::kNone;
    return report(solve_graph(graph(result_.knowledge.noise, !has_loss), solver_options_, &result_.T_map_vertex));
  }

  std::vector<GraphEdge> graph(const NoiseEstimate& noise, bool only_kept) const {
    std::vector<GraphEdge> edges;
    std::vector<Mat6> covariances;
    for (const OdometryEdge& edge : trajectory_.edges) covariances.push_back(odometry_covariance(edge, noise.odometry));
    for (const OdometryJump& jump : noise.jumps) covariances[jump.edge] += jump_covariance(jump);
    for (std::size_t i = 0; i < trajectory_.edges.size(); ++i) {
      SE3 T_from_to = trajectory_.edges[i].T_from_to;
      if (!steady_errors_.empty()) T_from_to = T_from_to * se3_exp(steady_errors_[i]);
      edges.push_back({static_cast<int>(i), static_cast<int>(i) + 1, T_from_to, square_root_information(covariances[i]),
                       1.0, false});
    }
    for (std::size_t k = 0; k < trajectory_.loops.size(); ++k) {
      const GraphLoop& loop = trajectory_.loops[k];
      const bool counts = has_vote(k) && (!only_kept || result_.knowledge.kept[k]);
      const double weight = counts ? 1.0 / redundancy_[k] : 0.0;
      edges.push_back({loop.from, loop.to, loop.T_from_to, square_root_information(loop.covariance) / noise.loop_factor,
                       weight, has_vote(k)});
    }
    return edges;
  }

  bool report(const GraphSolution& solution) {
    if (!solution.usable) result_.message = solution.message;
    return solution.usable;
  }

  const Trajectory& trajectory_;
  const PoseGraphOptions& options_;
  Effort effort_;
  std::vector<double> redundancy_;
  std::vector<Vec6> steady_errors_;  ///< of each edge; empty before they are known
  GraphSolverOptions solver_options_;
  OptimizedTrajectory result_;
};

}  // namespace

NoisePrior noise_prior(const PoseGraphOptions& options) {
  OdometryNoise least{options.translation_noise_m, radians(options.rotation_noise_deg)};
  least.steady_translation = least.scale = 0.1 * options.translation_noise_m;
  least.steady_rotation_rad = 0.1 * radians(options.rotation_noise_deg);
  return {least, options.noise_factor_max, options.noise_evidence};
}

OptimizedTrajectory optimize_trajectory(const Trajectory& trajectory, const PoseGraphOptions& options,
                                        const GraphKnowledge& knowledge, Effort effort) {
  return TrajectoryOptimizer(trajectory, options, knowledge, effort).run();
}

}  // namespace semantic_topo_loop::core
