#include "pose_graph/rejection/loop_clusters.h"

#include <algorithm>
#include <utility>

#include "odometry/noise_estimator.h"
#include "odometry/path_noise.h"

namespace semantic_topo_loop::core {
namespace {

using Cluster = std::vector<std::size_t>;

/// At most so many of those that are kept, evenly taken: the time of a fit grows with their cube.
std::vector<GraphLoop> some_of(const std::vector<GraphLoop>& loops, const std::vector<bool>& kept) {
  constexpr std::size_t kMaxLoops = 16;
  std::vector<GraphLoop> all, some;
  for (std::size_t k = 0; k < loops.size(); ++k) {
    if (kept[k]) all.push_back(loops[k]);
  }
  const std::size_t n = std::min(all.size(), kMaxLoops);
  for (std::size_t i = 0; i < n; ++i) some.push_back(all[i * all.size() / n]);
  return some;
}

/// A false loop may state any pose within some ten metres: logarithm of (10 m)^3 times all rotations, 8 pi^2.
constexpr double kLogPlaces = 11.3;
/// A piece of evidence is false once in ten times.
constexpr double kLogRare = 2.3;

double cost(const std::vector<SE3>& T_map_vertex, const std::vector<OdometryEdge>& edges,
            const std::vector<GraphLoop>& loops, const NoisePrior& prior) {
  constexpr int kJumps = 2;
  InnovationModel model(T_map_vertex, edges, loops);
  double cost = 0.0;
  estimate_noise_and_jumps(&model, prior, {prior.least, 1.0, {}}, kJumps, &cost);
  return cost;
}

/// Minus the log likelihood of a loop given others, linear about the given poses.
double surprise(const GraphLoop& loop, std::vector<GraphLoop> others, const std::vector<SE3>& T_map_vertex,
                const std::vector<OdometryEdge>& edges, const NoisePrior& prior) {
  const double alone = cost(T_map_vertex, edges, others, prior);
  others.push_back(loop);
  constexpr double kLogTwoPi = 1.8378771;
  return cost(T_map_vertex, edges, others, prior) - alone + 0.5 * 6.0 * kLogTwoPi;
}

double evidence(const Cluster& cluster, const std::vector<double>& redundancy) {
  double sum = 0.0;
  for (const std::size_t k : cluster) sum += 1.0 / redundancy[k];
  return sum;
}

const GraphLoop& middle(const Cluster& cluster, const Trajectory& trajectory) {
  return trajectory.loops[cluster[cluster.size() / 2]];
}

/// Those that strain the odometry most: a place that looks like another does.
std::vector<Cluster> strained(const Trajectory& trajectory, const std::vector<bool>& kept, const NoisePrior& prior) {
  constexpr std::size_t kMaxDoubted = 8;  // each costs a solution of the graph
  constexpr double kLittle = 10.0;        // times the least noise
  const PathNoise path(trajectory.T_map_vertex, trajectory.edges);
  const OdometryNoise least{prior.least.translation_m, prior.least.rotation_rad};
  std::vector<std::pair<double, Cluster>> clusters;
  for (Cluster& cluster : loop_clusters(trajectory.loops, kept)) {
    const double factor = path.explaining_factor(middle(cluster, trajectory), least, prior.factor_max);
    if (factor > kLittle) clusters.emplace_back(factor, std::move(cluster));
  }
  std::stable_sort(clusters.begin(), clusters.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
  if (clusters.size() > kMaxDoubted) clusters.resize(kMaxDoubted);
  std::vector<Cluster> result;
  for (auto& [factor, cluster] : clusters) result.push_back(std::move(cluster));
  return result;
}

/// The cluster that is most likely false.
class Suspicion {
 public:
  Suspicion(Trajectory* trajectory, const PoseGraphOptions& options, const GraphKnowledge& knowledge)
      : trajectory_(trajectory), options_(options), knowledge_(knowledge) {}

  void judge(const Cluster& cluster, double evidence) {
    GraphKnowledge others = knowledge_;
    for (const std::size_t k : cluster) others.kept[k] = false;
    trajectory_->votes = others.kept;
    OptimizedTrajectory without = optimize_trajectory(*trajectory_, options_, others, Effort::kUpdate);
    const GraphLoop& loop = middle(cluster, *trajectory_);
    if (!without.usable || chi_squared(loop, without.T_map_vertex) <= options_.robust_chi2) return;
    // Linear about the poses with and without the cluster: right loops behind large jumps are likely about the former.
    const std::vector<GraphLoop> rest = some_of(trajectory_->loops, without.knowledge.kept);
    const NoisePrior prior = noise_prior(options_);
    const double least_surprise = std::min(surprise(loop, rest, without.T_map_vertex, trajectory_->edges, prior),
                                           surprise(loop, rest, trajectory_->T_map_vertex, trajectory_->edges, prior));
    const double odds = least_surprise - kLogPlaces - kLogRare * evidence;
    if (odds <= odds_) return;
    odds_ = odds;
    kept_ = others.kept;
    T_map_vertex_ = std::move(without.T_map_vertex);
  }

  bool found() const { return odds_ > 0.0; }
  const std::vector<bool>& kept_without() const { return kept_; }
  const std::vector<SE3>& T_map_vertex_without() const { return T_map_vertex_; }

 private:
  Trajectory* trajectory_;
  const PoseGraphOptions& options_;
  const GraphKnowledge& knowledge_;
  double odds_ = 0.0;  ///< logarithm of those that it is false
  std::vector<bool> kept_;
  std::vector<SE3> T_map_vertex_;
};

}  // namespace

std::vector<bool> without_surprising_clusters(Trajectory trajectory, const PoseGraphOptions& options,
                                              GraphKnowledge knowledge) {
  trajectory.objects = {};
  const NoisePrior prior = noise_prior(options);
  while (loop_clusters(trajectory.loops, knowledge.kept).size() > 1) {
    const std::vector<double> copies = redundancy(trajectory.loops, knowledge.kept);
    Suspicion suspicion(&trajectory, options, knowledge);
    for (const Cluster& cluster : strained(trajectory, knowledge.kept, prior)) {
      suspicion.judge(cluster, evidence(cluster, copies));
    }
    if (!suspicion.found()) break;
    knowledge.kept = suspicion.kept_without();
    trajectory.T_map_vertex = suspicion.T_map_vertex_without();
  }
  return knowledge.kept;
}

}  // namespace semantic_topo_loop::core
