#include "pose_graph/solver/trajectory_optimizer.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "geometry/relative_pose.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

/// The walk, and a prior of 1 for suspected jumps.
OdometryNoise scaled(const OdometryNoise& noise, double factor) {
  return {noise.translation_m * factor, noise.rotation_rad * factor};
}

/// Whether more than the least is known of the odometry's errors.
bool exceeds(const NoiseEstimate& noise, const OdometryNoise& least) {
  const OdometryNoise& odometry = noise.odometry;
  return !noise.jumps.empty() || odometry.translation_m > least.translation_m ||
         odometry.rotation_rad > least.rotation_rad || odometry.steady_translation > least.steady_translation ||
         odometry.steady_rotation_rad > least.steady_rotation_rad || odometry.scale > least.scale ||
         odometry.jump_prior > least.jump_prior;
}

/// Where the loops find no more than the least noise they cannot tell how much less it is, and an odometry as good as a
/// motion capture must not be bent to their own errors: a tenth of it. Chosen on the true poses of fr3_office, where
/// 0.1 to 0.25 do alike.
OdometryNoise faultless(OdometryNoise noise) {
  constexpr double kShare = 0.1;
  for (double* sigma : {&noise.translation_m, &noise.rotation_rad, &noise.steady_translation,
                        &noise.steady_rotation_rad, &noise.scale}) {
    *sigma *= kShare;
  }
  return noise;
}

/// Factors on the usual least noise that a loop may need, over the usual and in all. A single burst may stand behind
/// some loops and not behind most: 15 cm after one metre is always granted. 40 cm are no odometry's: a loop that asks
/// for more has no say in what is usual either.
constexpr double kStrain = 2.5, kLeastStrain = 150.0, kMaxStrain = 400.0;

/// Log likelihood that one account of the odometry must bring over another: with few loops either may be more likely by
/// chance.
constexpr double kPrice = 5.0;

constexpr int kFewJumps = 2, kManyJumps = 8;  // that are looked for in one go: in a run and at its end, for time

/// How many edges before each vertex have a noise that is to be learnt.
std::vector<int> count_modelled(const std::vector<OdometryEdge>& edges) {
  std::vector<int> counts{0};
  for (const OdometryEdge& edge : edges) counts.push_back(counts.back() + (edge.is_modelled() ? 1 : 0));
  return counts;
}

class TrajectoryOptimizer {
 public:
  TrajectoryOptimizer(const Trajectory& trajectory, const PoseGraphOptions& options, const GraphKnowledge& knowledge,
                      Effort effort)
      : trajectory_(trajectory),
        options_(options),
        effort_(effort),
        votes_(trajectory.votes),
        modelled_(count_modelled(trajectory.edges)) {
    if (votes_.empty()) votes_.assign(trajectory.loops.size(), true);
    counts_ = votes_;
    for (std::size_t k = 0; k < knowledge.kept.size() && effort == Effort::kSettle; ++k) {
      counts_[k] = counts_[k] && knowledge.kept[k];
    }
    redundancy_ = redundancy(trajectory.loops, counts_);
    result_.T_map_vertex = trajectory.T_map_vertex;
    result_.knowledge = knowledge;
    // What is learnt last must not depend on what was believed on the way.
    if (starts_afresh() && options.estimate_noise) {
      result_.knowledge.noise = {noise_prior(options).least, 1.0, {}};
      result_.knowledge.prefers_measured = false;
    }
    if (options.robust == "huber") solver_options_.loss = GraphLoss::kHuber;
    if (options.robust == "cauchy") solver_options_.loss = GraphLoss::kCauchy;
    solver_options_.loss_chi2 = options.robust_chi2;
    solver_options_.max_iterations = options.max_iterations;
  }

  OptimizedTrajectory run() {
    if (!classify()) return result_;
    if (effort_ == Effort::kClassify) {
      result_.usable = true;
      return result_;
    }
    if (options_.estimate_noise) learn_noise();
    result_.usable = solve();
    if (result_.usable && has_objects()) solve_with_objects();
    return result_;
  }

  std::vector<OdometryEdge> settled() {
    std::vector<OdometryEdge> edges = motions();
    if (!is_noise_known()) return edges;
    if (options_.estimate_noise) learn_noise();
    const std::vector<Motion> judged = judged_motions(result_.knowledge.noise, Steady::kOpen);
    for (std::size_t i = 0; i < edges.size(); ++i) {
      if (!edges[i].is_break) edges[i].settle(judged[i].T_from_to, judged[i].covariance);
    }
    return edges;
  }

 private:
  bool starts_afresh() const { return effort_ != Effort::kUpdate && effort_ != Effort::kLearn; }
  bool doubts_all() const { return effort_ == Effort::kFull || effort_ == Effort::kClassify; }

  bool classify() {
    std::vector<bool>& kept = result_.knowledge.kept;
    kept.resize(trajectory_.loops.size(), true);
    if (options_.robust == "none") return true;
    vote_by_noise();
    for (std::size_t k = 0; k < kept.size(); ++k) kept[k] = kept[k] && votes_[k];
    const GraphKnowledge& known = result_.knowledge;
    const std::vector<GraphEdge> edges =
        graph({scaled(noise_prior(options_).least, known.loose_factor), 1.0, known.noise.jumps}, false);
    if (options_.robust != "gnc") {
      if (!solve_graph(edges, solver_options_, &result_.T_map_vertex).usable) return false;
      for (std::size_t k = 0; k < kept.size(); ++k) {
        kept[k] =
            votes_[k] && chi_squared(edges[trajectory_.edges.size() + k], result_.T_map_vertex) <= options_.robust_chi2;
      }
      return true;
    }
    std::vector<bool> guess;
    for (std::size_t k = 0; k < kept.size() && !doubts_all(); ++k) {
      if (votes_[k]) guess.push_back(kept[k]);
    }
    const LoopClassification classes =
        classify_loops(edges, options_.robust_chi2, solver_options_, result_.T_map_vertex, guess);
    if (!classes.usable) return false;
    std::size_t voter = 0;
    for (std::size_t k = 0; k < kept.size(); ++k) kept[k] = votes_[k] && classes.kept[voter++];
    result_.T_map_vertex = classes.T_world_vertex;
    return true;
  }

  /// Finds the odometry's noise that the loops bear out, and takes the vote from those that would need many times as
  /// much: a place that looks like another contradicts the odometry by any amount, a right loop by what the others do.
  void vote_by_noise() {
    const PathNoise path(result_.T_map_vertex, trajectory_.edges);
    const NoisePrior prior = noise_prior(options_);
    const OdometryNoise usual_least = usual_least_noise(options_);
    const double factor_max = std::max(prior.factor_max, 2.0 * kMaxStrain);  // what may be learnt bounds no verdict
    std::vector<double> factors, weights;
    for (std::size_t k = 0; k < votes_.size(); ++k) {
      if (!votes_[k]) continue;
      factors.push_back(path.explaining_factor(trajectory_.loops[k], usual_least, factor_max));
      const bool tells = counts_[k] && factors.back() <= kMaxStrain && is_modelled(trajectory_.loops[k]);
      weights.push_back(tells ? 1.0 / redundancy_[k] : 0.0);
    }
    double& loose = result_.knowledge.loose_factor;
    if (loose <= 0.0 || effort_ != Effort::kUpdate) {
      constexpr double kLeastFactor = 10.0;  // 1 cm after one metre: less room is of no use to right loops
      loose = kLeastFactor;
      if (options_.estimate_noise) {
        const double usual = std::min(robust_noise_factor(factors, weights), prior.factor_max);
        loose = std::max(loose, options_.gnc_loosening * usual);
      }
      loose = std::max(1.0, loose / noise_unit());
    }
    if (options_.robust != "gnc") return;
    const double limit = std::clamp(kStrain * loose * noise_unit() / options_.gnc_loosening, kLeastStrain, kMaxStrain);
    std::size_t voter = 0;
    for (std::size_t k = 0; k < votes_.size(); ++k) {
      if (!votes_[k]) continue;
      votes_[k] = factors[voter++] <= limit || path.has_stated(trajectory_.loops[k]);
    }
  }

  /// The least noise that the options state, in the usual one.
  double noise_unit() const {
    const OdometryNoise least = noise_prior(options_).least, usual = usual_least_noise(options_);
    return std::min(least.translation_m / usual.translation_m, least.rotation_rad / usual.rotation_rad);
  }

  int modelled(const GraphLoop& loop) const {
    return modelled_[static_cast<std::size_t>(loop.to)] - modelled_[static_cast<std::size_t>(loop.from)];
  }
  bool is_modelled(const GraphLoop& loop) const { return modelled(loop) == loop.to - loop.from; }

  /// Whether loops lead over most of the edges whose noise is to be learnt.
  bool is_noise_known() const {
    std::vector<int> ends(modelled_.size());  // how many more loops begin than end there
    for (std::size_t k = 0; k < trajectory_.loops.size(); ++k) {
      if (!result_.knowledge.kept[k]) continue;
      ++ends[static_cast<std::size_t>(trajectory_.loops[k].from)];
      --ends[static_cast<std::size_t>(trajectory_.loops[k].to)];
    }
    int below_loops = 0, loops = 0;
    for (std::size_t i = 0; i + 1 < ends.size(); ++i) {
      loops += ends[i];
      if (loops > 0) below_loops += modelled_[i + 1] - modelled_[i];
    }
    return 2 * below_loops > modelled_.back();
  }

  void learn_noise() {
    // As many as can be afforded, at the end of a run and in it: the cost grows with their cube.
    constexpr std::size_t kManyLoops = 60, kFewLoops = 24;
    const std::size_t max_loops = starts_afresh() ? kManyLoops : kFewLoops;
    GraphKnowledge& known = result_.knowledge;
    const std::vector<GraphLoop> some = some_kept(trajectory_.loops, telling_loops(trajectory_, known.kept), max_loops);
    InnovationModel model(result_.T_map_vertex, motions(), some, trajectory_.session_begins);
    if (effort_ != Effort::kUpdate) {
      const int max_new_jumps = starts_afresh() ? kManyJumps : kFewJumps;
      const auto fit = [&](InnovationModel* to) {
        return estimate_noise_and_jumps(to, noise_prior(options_), known.noise, max_new_jumps);
      };
      NoiseFit best = fit(&model);
      bool stays = starts_afresh() && is_faultless(model, best.noise);
      if (starts_afresh() && !trajectory_.measured.empty()) {
        InnovationModel other(result_.T_map_vertex, trajectory_.measured, some, trajectory_.session_begins);
        NoiseFit measured = fit(&other);
        stays = stays && is_faultless(other, measured.noise);
        known.prefers_measured = stays || measured.cost + kPrice < best.cost;
        if (known.prefers_measured) {
          best = std::move(measured);
          model = std::move(other);
        }
      }
      known.noise = std::move(best.noise);
      if (stays) known.noise.odometry = faultless(noise_prior(options_).least);
    }
    model.set_jumps(known.noise.jumps);
    steady_errors_ = model.steady_errors(known.noise);
  }

  /// Whether the loops find no more than the least noise, and would tell if there were more: without any, or with few
  /// and vague ones, nothing is found wrong either.
  bool is_faultless(const InnovationModel& model, const NoiseEstimate& noise) const {
    const OdometryNoise least = noise_prior(options_).least;
    if (exceeds(noise, least)) return false;
    constexpr double kRestless = 10.0;  // 1 cm after one metre: any odometry may drift so
    const OdometryNoise usual = usual_least_noise(options_);
    OdometryNoise restless = least;
    restless.translation_m = std::max(least.translation_m, kRestless * usual.translation_m);
    restless.rotation_rad = std::max(least.rotation_rad, kRestless * usual.rotation_rad);
    return model.cost(restless, noise.loop_factor) > model.cost(least, noise.loop_factor) + kPrice;
  }

  /// The odometry between the vertices that the solution rests on.
  const std::vector<OdometryEdge>& motions() const {
    return result_.knowledge.prefers_measured && !trajectory_.measured.empty() ? trajectory_.measured
                                                                               : trajectory_.edges;
  }

  bool solve() {
    const bool has_loss = solver_options_.loss != GraphLoss::kNone;
    result_.edges = graph(result_.knowledge.noise, !has_loss);
    return solve_graph(result_.edges, solver_options_, &result_.T_map_vertex).usable;
  }

  /// Where nothing is found wrong with the odometry, it knows more than boxes do; over a break that loops lead over it
  /// knows nothing.
  bool has_objects() const {
    if (trajectory_.objects.objects.empty()) return false;
    return options_.objects == "on" || exceeds(result_.knowledge.noise, noise_prior(options_).least) ||
           std::any_of(motions().begin(), motions().end(),
                       [](const OdometryEdge& edge) { return edge.missed.is_any(); }) ||
           is_joined_over_break();
  }

  bool is_joined_over_break() const {
    const auto is_break = [](const OdometryEdge& edge) { return edge.is_break; };
    for (std::size_t k = 0; k < trajectory_.loops.size(); ++k) {
      if (!result_.knowledge.kept[k]) continue;
      const auto [from, to] = std::minmax({trajectory_.loops[k].from, trajectory_.loops[k].to});
      if (std::any_of(motions().begin() + from, motions().begin() + to, is_break)) return true;
    }
    return false;
  }

  /// From the solution without them, which stays where this finds none.
  void solve_with_objects() {
    const bool has_loss = solver_options_.loss != GraphLoss::kNone;
    // For time, and less of it while the robot runs: what all objects together are seen in, and how often it is solved.
    constexpr int kLeastViews = 4, kManyViews = 6000, kFewViews = 400, kFewIterations = 6;
    const int share = (starts_afresh() ? kManyViews : kFewViews) / static_cast<int>(trajectory_.objects.objects.size());
    const int views = std::min(std::max(share, kLeastViews), options_.object_views);
    GraphSolverOptions solver_options = solver_options_;
    if (!starts_afresh()) solver_options.max_iterations = std::min(solver_options.max_iterations, kFewIterations);
    const GraphObjects seen = well_seen(trajectory_.objects, result_.T_map_vertex, views);
    if (seen.objects.empty()) return;
    solve_graph(graph(result_.knowledge.noise, !has_loss, Steady::kOpen), solver_options, &result_.T_map_vertex, seen);
  }

  /// The errors that last: as the loops tell them, or open to what changes along the way, which loops do not see.
  enum class Steady { kKnown, kOpen };

  /// The odometry as it is taken to be: without the errors that are known of, and as uncertain as the rest leaves it.
  struct Motion {
    SE3 T_from_to;
    Mat6 covariance;
  };
  std::vector<Motion> judged_motions(const NoiseEstimate& noise, Steady steady) const {
    std::vector<Motion> judged;
    for (const OdometryEdge& edge : motions()) {
      Motion motion{edge.T_from_to * se3_exp(expected_jump(edge, noise.odometry)).inverse(),
                    odometry_covariance(edge, noise.odometry)};
      if (!steady_errors_.empty()) motion.T_from_to = motion.T_from_to * se3_exp(steady_errors_[judged.size()]);
      if (steady == Steady::kOpen) motion.covariance += steady_covariance(edge, noise.odometry);
      judged.push_back(motion);
    }
    for (const OdometryJump& jump : noise.jumps) judged[jump.edge].covariance += jump.covariance();
    return judged;
  }

  std::vector<GraphEdge> graph(const NoiseEstimate& noise, bool only_kept, Steady steady = Steady::kKnown) const {
    std::vector<GraphEdge> edges;
    for (const Motion& motion : judged_motions(noise, steady)) {
      const int from = static_cast<int>(edges.size());
      edges.push_back({from, from + 1, motion.T_from_to, square_root_information(motion.covariance), 1.0, false});
    }
    for (std::size_t k = 0; k < trajectory_.loops.size(); ++k) {
      const GraphLoop& loop = trajectory_.loops[k];
      const bool counts = votes_[k] && (!only_kept || result_.knowledge.kept[k]);
      const double weight = counts ? 1.0 / redundancy_[k] : 0.0;
      edges.push_back({loop.from, loop.to, loop.T_from_to, square_root_information(loop.covariance) / noise.loop_factor,
                       weight, votes_[k]});
    }
    return edges;
  }

  const Trajectory& trajectory_;
  const PoseGraphOptions& options_;
  Effort effort_;
  std::vector<bool> votes_;   ///< which loops may be kept
  std::vector<bool> counts_;  ///< which of them say how noisy the odometry is, and share evidence
  std::vector<double> redundancy_;
  std::vector<int> modelled_;
  std::vector<Vec6> steady_errors_;  ///< of each edge; empty before they are known
  GraphSolverOptions solver_options_;
  OptimizedTrajectory result_;
};

}  // namespace

NoisePrior noise_prior(const PoseGraphOptions& options) {
  constexpr double kSteadyShare = 0.1;  // of the walk's figures: shows only after a hundred metres
  OdometryNoise least{options.translation_noise_m, radians(options.rotation_noise_deg)};
  least.steady_translation = least.scale = kSteadyShare * options.translation_noise_m;
  least.steady_rotation_rad = kSteadyShare * radians(options.rotation_noise_deg);
  constexpr double kLeastJumpPrior = 0.003;  // next to none: without loops the odometry stays as it is
  if (options.estimate_noise) least.jump_prior = kLeastJumpPrior;
  return {least, options.noise_factor_max, options.noise_evidence};
}

OdometryNoise usual_least_noise(const PoseGraphOptions& options) {
  PoseGraphOptions usual;
  usual.estimate_noise = options.estimate_noise;
  return noise_prior(usual).least;
}

OptimizedTrajectory optimize_trajectory(const Trajectory& trajectory, const PoseGraphOptions& options,
                                        const GraphKnowledge& knowledge, Effort effort) {
  return TrajectoryOptimizer(trajectory, options, knowledge, effort).run();
}

std::vector<OdometryEdge> settled_odometry(const Trajectory& trajectory, const PoseGraphOptions& options,
                                           const GraphKnowledge& knowledge) {
  return TrajectoryOptimizer(trajectory, options, knowledge, Effort::kUpdate).settled();
}

std::vector<bool> telling_loops(const Trajectory& trajectory, const std::vector<bool>& kept) {
  const std::vector<int> modelled = count_modelled(trajectory.edges);
  std::vector<bool> tell = kept;
  for (std::size_t k = 0; k < tell.size(); ++k) {
    const auto from = static_cast<std::size_t>(trajectory.loops[k].from),
               to = static_cast<std::size_t>(trajectory.loops[k].to);
    tell[k] = tell[k] && modelled[from] != modelled[to];
  }
  return std::find(tell.begin(), tell.end(), true) == tell.end() ? kept : tell;
}

std::vector<Carrier> coarsen(std::size_t size, const std::vector<bool>& has_loops, std::vector<std::size_t>* keyframes,
                             Trajectory* trajectory) {
  std::vector<std::size_t> left(keyframes->size());  // numbers of the vertices that stay
  for (std::size_t v = 0; v < left.size(); ++v) left[v] = v;
  const auto keyframe = [&](std::size_t i) { return (*keyframes)[left[i]]; };
  const auto place = [](std::size_t v) { return static_cast<std::ptrdiff_t>(v); };
  const auto has_loop = [&](std::size_t i) {
    const auto begin = has_loops.begin();
    return std::find(begin + place(left[i]), begin + place(left[i + 1]), true) != begin + place(left[i + 1]);
  };
  bool goes_over_breaks = false;
  while (left.size() > std::max<std::size_t>(size, 2)) {
    std::size_t closest = 0;
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t i = 1; i + 1 < left.size(); ++i) {
      if (trajectory->edges[left[i] - 1].is_break && (!goes_over_breaks || has_loop(i))) continue;
      const double share =
          static_cast<double>(keyframe(i + 1) - keyframe(i - 1)) / static_cast<double>(keyframes->back() - keyframe(i));
      if (share >= least) continue;
      closest = i;
      least = share;
    }
    if (closest == 0 && goes_over_breaks) break;
    goes_over_breaks = goes_over_breaks || closest == 0;
    if (closest != 0) left.erase(left.begin() + place(closest));
  }
  std::vector<Carrier> result;
  Trajectory coarse;
  std::vector<std::size_t> coarse_keyframes;
  for (std::size_t v = 0; v < keyframes->size(); ++v) {
    if (coarse_keyframes.size() < left.size() && v == left[coarse_keyframes.size()]) {
      coarse.T_map_vertex.push_back(trajectory->T_map_vertex[v]);
      coarse_keyframes.push_back((*keyframes)[v]);
      if (v + 1 < keyframes->size()) coarse.edges.push_back(trajectory->edges[v]);
      result.push_back({static_cast<int>(coarse_keyframes.size()) - 1, std::nullopt});
    } else {
      coarse.edges.back() = join(coarse.edges.back(), trajectory->edges[v]);
      result.push_back({static_cast<int>(coarse_keyframes.size()) - 1,
                        coarse.T_map_vertex.back().inverse() * trajectory->T_map_vertex[v]});
    }
  }
  trajectory->T_map_vertex = std::move(coarse.T_map_vertex);
  trajectory->edges = std::move(coarse.edges);
  *keyframes = std::move(coarse_keyframes);
  return result;
}

}  // namespace semantic_topo_loop::core
