#include "pose_graph/rejection/loop_rejection.h"

#include <algorithm>
#include <iomanip>
#include <map>
#include <sstream>
#include <utility>

#include "odometry/noise_estimator.h"

namespace semantic_topo_loop::core {
namespace {

/// A loop within one vertex says nothing that its poses do not say already.
bool is_open(const GraphLoop& loop) { return loop.from != loop.to; }

}  // namespace

const GraphLoop* LoopRejection::add(const LoopClosure& closure, int query, int match, bool is_extra,
                                    const CarrierOf& carrier) {
  const Result<GraphLoop> loop = make_graph_loop(closure, query, match);
  Entry entry;
  entry.told = {accepted_++, closure.query_keyframe_id, closure.match_keyframe_id, false, {}, is_extra};
  entry.refusal = loop.message();
  if (loop) entry.loop = carried(*loop, carrier(loop->from), carrier(loop->to));
  entry.is_in_graph = loop && is_open(*entry.loop) && !is_repetition(*entry.loop, entries_.size());
  entries_.push_back(std::move(entry));
  return entries_.back().is_in_graph ? &*entries_.back().loop : nullptr;
}

void LoopRejection::move(const CarrierOf& carrier) {
  std::vector<bool> stays;
  for (Entry& entry : entries_) {
    if (entry.loop) entry.loop = carried(*entry.loop, carrier(entry.loop->from), carrier(entry.loop->to));
    if (!entry.is_in_graph) continue;
    entry.loop->had_support = entry.loop->had_support || (entry.is_told && entry.may_vote);
    entry.is_in_graph = is_open(*entry.loop);
    stays.push_back(entry.is_in_graph);
  }
  consistency_.keep(stays);
}

void LoopRejection::bound(std::size_t most) {
  constexpr std::size_t kMaxOthers = 1000;  // a few minutes of them where loops are found all the time
  const std::size_t in_graph = size();
  const bool is_full = in_graph > most;
  if (!is_full && entries_.size() - in_graph <= 2 * kMaxOthers) return;
  constexpr int kLoopsOfAVertex = 2;  // so that there are at most as many loops as twice the vertices
  std::vector<bool> stays(entries_.size());
  std::vector<std::size_t> graph;
  std::size_t others = 0;
  for (std::size_t i = entries_.size(); i-- > 0;) {
    if (entries_[i].is_in_graph && is_full) graph.push_back(i);
    stays[i] = entries_[i].is_in_graph ? !is_full : others++ < kMaxOthers;
  }
  std::stable_sort(graph.begin(), graph.end(), [this](std::size_t i, std::size_t j) {
    const Entry &p = entries_[i], &q = entries_[j];
    return p.kept != q.kept ? p.kept : p.loop->covariance.trace() < q.loop->covariance.trace();
  });
  std::map<int, int> loops_at;  // by vertex
  for (const std::size_t i : graph) {
    GraphLoop& loop = *entries_[i].loop;
    loop.had_support = loop.had_support || entries_[i].may_vote;
    int &at_from = loops_at[loop.from], &at_to = loops_at[loop.to];
    stays[i] = std::min(at_from, at_to) < kLoopsOfAVertex;
    at_from += stays[i] ? 1 : 0;
    at_to += stays[i] ? 1 : 0;
  }
  std::vector<bool> graph_stays;
  std::vector<Entry> left;
  for (std::size_t i = 0; i < entries_.size(); ++i) {
    if (entries_[i].is_in_graph) graph_stays.push_back(stays[i]);
    if (stays[i]) left.push_back(std::move(entries_[i]));
  }
  entries_ = std::move(left);
  consistency_.keep(graph_stays);
}

bool LoopRejection::withdraw(std::int64_t query_keyframe_id, std::int64_t match_keyframe_id) {
  const auto rest = std::stable_partition(entries_.begin(), entries_.end(), [=](const Entry& entry) {
    return entry.told.query_keyframe_id != query_keyframe_id || entry.told.match_keyframe_id != match_keyframe_id;
  });
  if (rest == entries_.end()) return false;
  for (auto entry = rest; entry != entries_.end(); ++entry) {
    withdrawn_.push_back(entry->told);
    withdrawn_.back().kept = false;
    withdrawn_.back().reason = "withdrawn";
  }
  entries_.erase(rest, entries_.end());
  consistency_.clear();
  return true;
}

void LoopRejection::restore(std::vector<RememberedLoop> loops, std::int64_t accepted) {
  entries_ = std::move(loops);
  for (Entry& entry : entries_) entry.is_settled = entry.kept;
  accepted_ = accepted;
  consistency_.clear();
}

std::vector<bool> LoopRejection::at_vertices(std::size_t vertices) const {
  std::vector<bool> result(vertices, false);
  for (const Entry& entry : entries_) {
    if (!entry.loop) continue;
    for (const int end : {entry.loop->from, entry.loop->to}) result[static_cast<std::size_t>(end)] = true;
  }
  return result;
}

std::size_t LoopRejection::size() const {
  return static_cast<std::size_t>(std::count_if(entries_.begin(), entries_.end(), is_in_graph));
}

/// Whether the graph has the evidence of a loop often enough, in loops before `end` that are believed. The more of them
/// it holds the sooner it has, so that the time of a solve hardly grows.
bool LoopRejection::is_repetition(const GraphLoop& loop, std::size_t end) const {
  constexpr double kMany = 400.0;  // loops: beyond, each place has room for fewer
  constexpr double kCopy = 0.99;   // shared evidence of one loop that is given twice, up to rounding
  double sum = 0.0, loops = 0.0;
  for (std::size_t i = 0; i < end; ++i) {
    const Entry& entry = entries_[i];
    if (!entry.is_in_graph || !entry.kept) continue;
    const double shared = shared_evidence(loop, *entry.loop);
    if (shared > kCopy) return true;
    sum += shared;
    loops += 1.0;
  }
  return sum >= options_.max_redundancy * std::min(1.0, kMany / std::max(loops, 1.0));
}

void LoopRejection::hand_over(Trajectory* trajectory, GraphKnowledge* knowledge) const {
  trajectory->loops.clear();
  trajectory->votes.clear();
  knowledge->kept.clear();
  for (const Entry& entry : entries_) {
    if (!entry.is_in_graph) continue;
    trajectory->loops.push_back(*entry.loop);
    trajectory->votes.push_back(entry.may_vote);
    knowledge->kept.push_back(entry.kept);
  }
}

void LoopRejection::take_back(const Trajectory& trajectory, const GraphKnowledge& knowledge) {
  std::size_t k = 0;
  for (Entry& entry : entries_) {
    if (!entry.is_in_graph) continue;
    entry.may_vote = trajectory.votes[k];
    entry.kept = knowledge.kept[k];
    ++k;
  }
}

std::vector<bool> LoopRejection::vote(const Trajectory& trajectory, bool has_moved) {
  if (has_moved) consistency_.clear();
  return consistency_.vote(trajectory.edges, trajectory.loops);
}

bool LoopRejection::reject_outliers(Trajectory* trajectory, GraphKnowledge* knowledge) {
  const std::vector<bool> voted = trajectory->votes;
  if (!classify(trajectory, knowledge)) return false;
  // Loops that were outvoted by outliers get another chance.
  std::vector<bool> eligible = knowledge->kept;
  for (std::size_t k = 0; k < voted.size(); ++k) eligible[k] = eligible[k] || !voted[k];
  trajectory->votes = consistency_.vote(trajectory->edges, trajectory->loops, eligible, knowledge->kept);
  if (trajectory->votes != knowledge->kept && !classify(trajectory, knowledge)) return false;
  drop_outliers(voted, trajectory, knowledge);
  if (!judge_anew({}, trajectory, knowledge)) return false;
  std::vector<bool> settled;
  for (const Entry& entry : entries_) {
    if (entry.is_in_graph) settled.push_back(entry.is_settled);
  }
  const std::vector<bool> believed = audit_clusters(*trajectory, options_, *knowledge, settled);
  if (believed == knowledge->kept) return true;
  std::vector<bool> outliers = knowledge->kept;
  for (std::size_t k = 0; k < believed.size(); ++k) outliers[k] = outliers[k] && !believed[k];
  // How far off the others are is judged where the outliers do not pull.
  trajectory->votes = knowledge->kept = believed;
  return classify(trajectory, knowledge) && judge_anew(outliers, trajectory, knowledge);
}

/// Where right loops lie at the border, what was rejected on the way there sways the verdict on them. So the last one
/// is made anew among those that are not far off.
/// @param outliers one a loop; empty: none is
bool LoopRejection::judge_anew(const std::vector<bool>& outliers, Trajectory* trajectory, GraphKnowledge* knowledge) {
  constexpr double kFarOff = 10.0;  // times the bound on chi^2: beyond three times the sigmas that are allowed
  std::vector<bool> eligible;
  for (std::size_t k = 0; k < trajectory->loops.size(); ++k) {
    const bool is_outlier = !outliers.empty() && outliers[k];
    const double chi2 = chi_squared(trajectory->loops[k], trajectory->T_map_vertex);
    eligible.push_back(!is_outlier && chi2 <= kFarOff * options_.robust_chi2);
  }
  trajectory->votes = consistency_.vote(trajectory->edges, trajectory->loops, eligible);
  if (!classify(trajectory, knowledge)) return false;
  drop_outliers(eligible, trajectory, knowledge);
  return true;
}

bool LoopRejection::classify(Trajectory* trajectory, GraphKnowledge* knowledge) const {
  OptimizedTrajectory result = optimize_trajectory(*trajectory, options_, *knowledge, Effort::kClassify);
  if (!result.usable) return false;
  trajectory->T_map_vertex = std::move(result.T_map_vertex);
  *knowledge = std::move(result.knowledge);
  return true;
}

/// An outlier shall leave no trace: which loops repeat others follows from those that fit.
/// @param had_vote in the first round, one a loop of the graph: says why a loop is not kept
void LoopRejection::drop_outliers(const std::vector<bool>& had_vote, Trajectory* trajectory,
                                  GraphKnowledge* knowledge) {
  std::size_t k = 0;
  for (std::size_t i = 0; i < entries_.size(); ++i) {
    Entry& entry = entries_[i];
    if (!entry.loop) continue;
    const bool was_in_graph = entry.is_in_graph;
    entry.kept =
        was_in_graph ? knowledge->kept[k] : chi_squared(*entry.loop, trajectory->T_map_vertex) <= options_.robust_chi2;
    entry.may_vote = entry.kept || !was_in_graph || had_vote[k];
    entry.is_in_graph = is_open(*entry.loop) && (!entry.kept || !is_repetition(*entry.loop, i));
    k += was_in_graph ? 1 : 0;
  }
  hand_over(trajectory, knowledge);
  consistency_.clear();
}

LoopVerdict LoopRejection::verdict(const Entry& entry, const Chi2& chi2, double loop_factor) const {
  LoopVerdict verdict = entry.told;
  verdict.kept = false;
  verdict.reason = entry.refusal;
  if (!entry.loop) return verdict;
  // What was found holds, when its keyframes have become one vertex of a coarser graph.
  if (entry.is_told && !is_open(*entry.loop)) return entry.told;
  const double disagreement = chi2(*entry.loop) / (loop_factor * loop_factor);
  verdict.kept = entry.is_in_graph ? entry.kept : disagreement <= options_.robust_chi2;
  if (entry.is_in_graph && !entry.may_vote) {
    verdict.reason = "no other loop agrees with it or more disagree";
  } else if (!verdict.kept) {
    std::ostringstream reason;
    reason << "disagrees with the odometry and the other loops: squared error " << std::setprecision(3) << disagreement
           << " sigma^2";
    verdict.reason = reason.str();
  } else if (!entry.is_in_graph) {
    verdict.reason = "repeats the evidence of other loops";
  }
  return verdict;
}

std::vector<LoopVerdict> LoopRejection::new_verdicts(const Chi2& chi2, double loop_factor) {
  std::vector<LoopVerdict> verdicts = std::exchange(withdrawn_, {});
  for (Entry& entry : entries_) {
    LoopVerdict now = verdict(entry, chi2, loop_factor);
    if (std::exchange(entry.is_told, true) && now.kept == entry.told.kept && now.reason == entry.told.reason) continue;
    entry.told = now;
    verdicts.push_back(std::move(now));
  }
  std::stable_sort(verdicts.begin(), verdicts.end(), [](const auto& a, const auto& b) { return a.number < b.number; });
  return verdicts;
}

namespace {

using Cluster = std::vector<std::size_t>;

/// A false loop may state any pose within some ten metres: logarithm of (10 m)^3 times all rotations, 8 pi^2.
constexpr double kLogPlaces = 11.3;
/// A piece of evidence is false once in ten times: logarithm of 10.
constexpr double kLogRare = 2.3;

double cost(const std::vector<SE3>& T_map_vertex, const Trajectory& trajectory, const std::vector<GraphLoop>& loops,
            const NoisePrior& prior) {
  constexpr int kJumps = 2;  // that may stand behind the cluster, beside those that the motion shows
  InnovationModel model(T_map_vertex, trajectory.edges, loops, trajectory.session_begins);
  return estimate_noise_and_jumps(&model, prior, {prior.least, 1.0, {}}, kJumps).cost;
}

/// Minus the log likelihood of a loop given others, linear about the given poses.
double unlikelihood(const GraphLoop& loop, std::vector<GraphLoop> others, const std::vector<SE3>& T_map_vertex,
                    const Trajectory& trajectory, const NoisePrior& prior) {
  const double alone = cost(T_map_vertex, trajectory, others, prior);
  others.push_back(loop);
  constexpr double kLogTwoPi = 1.8378771;  // of the normal distribution, for each of six dimensions
  return cost(T_map_vertex, trajectory, others, prior) - alone + 0.5 * 6.0 * kLogTwoPi;
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
/// @param doubted one a loop
std::vector<Cluster> strained(const Trajectory& trajectory, const std::vector<bool>& doubted,
                              const PoseGraphOptions& options) {
  constexpr std::size_t kMaxDoubted = 8;  // each costs a solution of the graph
  constexpr double kLittle = 10.0;        // times the usual noise, 1 cm after one metre: any odometry may drift so
  const PathNoise path(trajectory.T_map_vertex, trajectory.edges);
  const OdometryNoise usual = usual_least_noise(options), walk{usual.translation_m, usual.rotation_rad};
  std::vector<std::pair<double, Cluster>> clusters;
  for (Cluster& cluster : loop_clusters(trajectory.loops, doubted)) {
    const double factor = path.explaining_factor(middle(cluster, trajectory), walk, options.noise_factor_max);
    if (factor > kLittle) clusters.emplace_back(factor, std::move(cluster));
  }
  std::stable_sort(clusters.begin(), clusters.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
  if (clusters.size() > kMaxDoubted) clusters.resize(kMaxDoubted);
  std::vector<Cluster> result;
  result.reserve(clusters.size());
  for (auto& [factor, cluster] : clusters) result.push_back(std::move(cluster));
  return result;
}

/// A cluster that is likely false.
struct Outlier {
  double odds = 0.0;  ///< logarithm of those that it is false
  std::vector<bool> kept_without;
  std::vector<SE3> T_map_vertex_without;
};

/// @param worst so far, which this cluster takes the place of if it is more likely false
void judge(const Cluster& cluster, double evidence, const PoseGraphOptions& options, const GraphKnowledge& knowledge,
           Trajectory* trajectory, Outlier* worst) {
  constexpr std::size_t kMaxLoops = 16;  // the time of a fit grows with their cube, and each cluster needs four
  GraphKnowledge others = knowledge;
  for (const std::size_t k : cluster) others.kept[k] = false;
  trajectory->votes = others.kept;
  OptimizedTrajectory without = optimize_trajectory(*trajectory, options, others, Effort::kUpdate);
  const GraphLoop& loop = middle(cluster, *trajectory);
  if (!without.usable || chi_squared(loop, without.T_map_vertex) <= options.robust_chi2) return;
  // Linear about the poses with and without the cluster: right loops behind large jumps are likely about the former.
  const std::vector<GraphLoop> rest =
      some_kept(trajectory->loops, telling_loops(*trajectory, without.knowledge.kept), kMaxLoops);
  const NoisePrior prior = noise_prior(options);
  const double least = std::min(unlikelihood(loop, rest, without.T_map_vertex, *trajectory, prior),
                                unlikelihood(loop, rest, trajectory->T_map_vertex, *trajectory, prior));
  const double odds = least - kLogPlaces - kLogRare * evidence;
  if (odds > worst->odds) *worst = {odds, std::move(others.kept), std::move(without.T_map_vertex)};
}

}  // namespace

std::vector<bool> audit_clusters(Trajectory trajectory, const PoseGraphOptions& options, GraphKnowledge knowledge,
                                 const std::vector<bool>& settled) {
  trajectory.objects = {};
  while (loop_clusters(trajectory.loops, knowledge.kept).size() > 1) {
    const std::vector<double> copies = redundancy(trajectory.loops, knowledge.kept);
    std::vector<bool> doubted = knowledge.kept;
    for (std::size_t k = 0; k < settled.size(); ++k) doubted[k] = doubted[k] && !settled[k];
    Outlier worst;
    for (const Cluster& cluster : strained(trajectory, doubted, options)) {
      judge(cluster, evidence(cluster, copies), options, knowledge, &trajectory, &worst);
    }
    if (worst.kept_without.empty()) break;
    knowledge.kept = std::move(worst.kept_without);
    trajectory.T_map_vertex = std::move(worst.T_map_vertex_without);
  }
  return knowledge.kept;
}

}  // namespace semantic_topo_loop::core
