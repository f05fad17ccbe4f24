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

class TrajectoryOptimizer {
 public:
  TrajectoryOptimizer(const Trajectory& trajectory, const PoseGraphOptions& options, const NoiseEstimate& noise)
      : trajectory_(trajectory), options_(options), redundancy_(redundancy(trajectory.loops)) {
    result_.T_map_vertex = trajectory.T_map_vertex;
    result_.noise = noise;
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
    result_.kept.assign(trajectory_.loops.size(), true);
    if (options_.robust == "none") return true;
    const std::vector<GraphEdge> edges = graph(loose_noise(), false);
    if (options_.robust != "gnc") {
      if (!report(solve_graph(edges, solver_options_, &result_.T_map_vertex))) return false;
      for (std::size_t k = 0; k < result_.kept.size(); ++k) {
        result_.kept[k] =
            chi_squared(edges[trajectory_.edges.size() + k], result_.T_map_vertex) <= options_.robust_chi2;
      }
      return true;
    }
    const LoopClassification classes =
        classify_loops(edges, options_.robust_chi2, solver_options_, result_.T_map_vertex);
    if (!classes.usable) {
      result_.message = "the loops could not be classified";
      return false;
    }
    result_.kept = classes.kept;
    result_.T_map_vertex = classes.T_world_vertex;
    return true;
  }

  NoiseEstimate loose_noise() const {
    const NoisePrior prior = noise_prior(options_);
    constexpr double kLeastFactor = 10.0;  // 1 cm after one metre: less room is of no use to right loops
    double factor = kLeastFactor;
    if (options_.estimate_noise) {
      const InnovationModel model(result_.T_map_vertex, trajectory_.edges, trajectory_.loops);
      factor = std::max(factor, options_.gnc_loosening * robust_noise_factor(model, prior, redundancy_));
    }
    return {scaled(prior.least, factor), 1.0};
  }

  void learn_noise() {
    constexpr std::size_t kMaxLoops = 50;
    std::vector<GraphLoop> loops;
    for (std::size_t k = 0; k < trajectory_.loops.size(); ++k) {
      if (result_.kept[k]) loops.push_back(trajectory_.loops[k]);
    }
    const InnovationModel model(result_.T_map_vertex, trajectory_.edges, thinned(loops, kMaxLoops));
    result_.noise = core::estimate_noise(model, noise_prior(options_), result_.noise);
  }

  bool solve() {
    const bool has_loss = solver_options_.loss != GraphLoss::kNone;
    return report(solve_graph(graph(result_.noise, !has_loss), solver_options_, &result_.T_map_vertex));
  }

  std::vector<GraphEdge> graph(const NoiseEstimate& noise, bool only_kept) const {
    std::vector<GraphEdge> edges;
    for (std::size_t i = 0; i < trajectory_.edges.size(); ++i) {
      const OdometryEdge& edge = trajectory_.edges[i];
      edges.push_back({static_cast<int>(i), static_cast<int>(i) + 1, edge.T_from_to,
                       square_root_information(odometry_covariance(edge, noise.odometry)), 1.0, false});
    }
    for (std::size_t k = 0; k < trajectory_.loops.size(); ++k) {
      const GraphLoop& loop = trajectory_.loops[k];
      const double weight = only_kept && !result_.kept[k] ? 0.0 : 1.0 / redundancy_[k];
      edges.push_back({loop.from, loop.to, loop.T_from_to, square_root_information(loop.covariance) / noise.loop_factor,
                       weight, true});
    }
    return edges;
  }

  bool report(const GraphSolution& solution) {
    if (!solution.usable) result_.message = solution.message;
    return solution.usable;
  }

  const Trajectory& trajectory_;
  const PoseGraphOptions& options_;
  std::vector<double> redundancy_;
  GraphSolverOptions solver_options_;
  OptimizedTrajectory result_;
};

}  // namespace

NoisePrior noise_prior(const PoseGraphOptions& options) {
  return {{options.translation_noise_m, radians(options.rotation_noise_deg)},
          options.noise_factor_max,
          options.noise_evidence};
}

OptimizedTrajectory optimize_trajectory(const Trajectory& trajectory, const PoseGraphOptions& options,
                                        const NoiseEstimate& noise) {
  return TrajectoryOptimizer(trajectory, options, noise).run();
}

}  // namespace semantic_topo_loop::core
