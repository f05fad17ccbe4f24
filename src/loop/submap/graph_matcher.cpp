#include "loop/submap/graph_matcher.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <utility>

#include "geometry/statistics.h"
#include "semantic_topo_loop/geometry/alignment.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

class CliqueSearch {
 public:
  CliqueSearch(const BitGraph& graph, int max_steps) : graph_(graph), steps_left_(max_steps) {}

  Clique run() {
    expand(Bits(graph_.size(), true));
    std::sort(best_.begin(), best_.end());
    return best_;
  }

 private:
  struct Colored {
    std::size_t vertex, color;
  };

  /// Greedy coloring: a clique within the vertices up to one of color c has at most c members.
  std::vector<Colored> color(const Bits& candidates) const {
    std::vector<Colored> order;
    Bits uncolored = candidates;
    for (std::size_t color = 1; uncolored.any(); ++color) {
      Bits open = uncolored;
      for (std::size_t vertex = open.next(0); vertex != Bits::kNone; vertex = open.next(vertex + 1)) {
        uncolored.reset(vertex);
        open -= graph_[vertex];
        order.push_back({vertex, color});
      }
    }
    return order;
  }

  void expand(Bits candidates) {
    const std::vector<Colored> order = color(candidates);
    for (auto it = order.rbegin(); it != order.rend(); ++it) {
      if (current_.size() + it->color <= best_.size() || steps_left_-- <= 0) return;
      current_.push_back(it->vertex);
      Bits next = candidates;
      next &= graph_[it->vertex];
      if (next.any()) {
        expand(next);
      } else if (current_.size() > best_.size()) {
        best_ = current_;
      }
      current_.pop_back();
      candidates.reset(it->vertex);
    }
  }

  const BitGraph& graph_;
  int steps_left_;
  Clique current_, best_;
};

/// Bounds, so that a crowded place cannot hold up an attempt. Of the exact search: the best clique so far counts then.
constexpr int kMaxCliqueSteps = 20000;
/// Of correspondences that cliques are looked for among, whose cube the time grows with: those of twenty objects alike.
constexpr std::size_t kMaxSeeds = 400;
static_assert(kMaxSeeds <= Bits::kMax);
/// Room for most cliques, so that they need not be moved while they grow.
constexpr std::size_t kUsualClique = 32;
/// A round that finds the inliers of the one before ends it; a set that swings is left as it is.
constexpr int kRegrowRounds = 3;
/// Residual at which an inlier's share of the score has fallen to exp(-1/2): half the usual inlier distance.
constexpr double kScoreSigmaShare = 0.5;
constexpr std::size_t kMaxMatches = 4;  ///< distinct alternatives returned
constexpr int kMaxCliques = 24;         ///< aligned at most
/// Two alignments differ if the graph's middle moves farther or turns more.
constexpr double kDistinct_m = 0.3, kDistinct_rad = 0.26;

bool is_usable(const LabelledPoint& point) {
  return point.label >= 0 && point.position.allFinite() && std::isfinite(point.size) && point.size > 0.0;
}

/// True if two matches put the graph's middle at different places, or turn it differently.
bool are_distinct(const std::vector<LabelledPoint>& b, const GraphMatch& p, const GraphMatch& q) {
  Vec3 middle = Vec3::Zero();
  for (const NodePair& pair : p.pairs) {
    middle += b[static_cast<std::size_t>(pair.b)].position / static_cast<double>(p.pairs.size());
  }
  return (p.T_a_b * (p.scale * middle) - q.T_a_b * (q.scale * middle)).norm() > kDistinct_m ||
         rotation_angle(p.T_a_b.q, q.T_a_b.q) > kDistinct_rad;
}

std::size_t count_distinct(std::vector<int> numbers) {
  std::sort(numbers.begin(), numbers.end());
  return static_cast<std::size_t>(std::unique(numbers.begin(), numbers.end()) - numbers.begin());
}

std::optional<Alignment> align(const std::vector<NodePair>& pairs, const std::vector<LabelledPoint>& a,
                               const std::vector<LabelledPoint>& b, bool with_scale = false) {
  std::vector<Vec3> points_a, points_b;
  points_a.reserve(pairs.size());
  points_b.reserve(pairs.size());
  for (const NodePair& pair : pairs) {
    points_a.push_back(a[static_cast<std::size_t>(pair.a)].position);
    points_b.push_back(b[static_cast<std::size_t>(pair.b)].position);
  }
  return align_points(points_a, points_b, with_scale);
}

class Matching {
 public:
  Matching(const LoopOptions& options, int min_pairs, const std::vector<LabelledPoint>& a,
           const std::vector<LabelledPoint>& b)
      : options_(options),
        min_pairs_(static_cast<std::size_t>(min_pairs)),
        a_(a),
        b_(b),
        distances_a_(distances(a)),
        distances_b_(distances(b)) {
    for (int i = 0; i < static_cast<int>(a.size()); ++i) {
      if (!is_usable(at(a_, i))) continue;
      for (int j = 0; j < static_cast<int>(b.size()); ++j) {
        if (is_usable(at(b_, j)) && may_correspond(at(a_, i), at(b_, j))) candidates_.push_back({i, j});
      }
    }
    seeds_ = bounded(candidates_);
  }

  std::vector<GraphMatch> run() const {
    std::vector<GraphMatch> matches;
    if (candidates_.size() < min_pairs_) return matches;
    const BitGraph graph = consistency_graph();
    int aligned = 0;
    for (const Clique& clique : cliques(graph)) {
      if (aligned == kMaxCliques) break;
      if (is_covered(clique, matches)) continue;
      ++aligned;
      const std::size_t best = matches.empty() ? 0 : matches.front().pairs.size();
      std::optional<GraphMatch> match = grow(clique, least_beside(best));
      if (match) insert(std::move(*match), &matches);
    }
    if (matches.size() > kMaxMatches) matches.resize(kMaxMatches);
    return matches;
  }

 private:
  static const LabelledPoint& at(const std::vector<LabelledPoint>& points, int i) {
    return points[static_cast<std::size_t>(i)];
  }

  bool may_correspond(const LabelledPoint& p, const LabelledPoint& q) const {
    return p.label == q.label && std::abs(std::log(p.size / q.size)) < options_.size_ratio_log;
  }

  /// Of each point of a as many as of the others, those most alike in size, so that what is rare loses none to what is
  /// common; in the order that they had.
  std::vector<NodePair> bounded(std::vector<NodePair> pairs) const {
    if (pairs.size() <= kMaxSeeds) return pairs;
    const auto difference = [this](const NodePair& p) {
      return std::abs(std::log(at(a_, p.a).size / at(b_, p.b).size));
    };
    std::stable_sort(pairs.begin(), pairs.end(), [&](const NodePair& p, const NodePair& q) {
      return std::pair(p.a, difference(p)) < std::pair(q.a, difference(q));
    });
    std::vector<std::pair<int, NodePair>> ranked;  // among those of one point
    for (const NodePair& pair : pairs) {
      const bool goes_on = !ranked.empty() && ranked.back().second.a == pair.a;
      ranked.emplace_back(goes_on ? ranked.back().first + 1 : 0, pair);
    }
    std::stable_sort(ranked.begin(), ranked.end(), [](const auto& p, const auto& q) { return p.first < q.first; });
    pairs.clear();
    for (std::size_t i = 0; i < kMaxSeeds; ++i) pairs.push_back(ranked[i].second);
    std::sort(pairs.begin(), pairs.end(),
              [](const NodePair& p, const NodePair& q) { return std::pair(p.a, p.b) < std::pair(q.a, q.b); });
    return pairs;
  }

  static Eigen::MatrixXd distances(const std::vector<LabelledPoint>& points) {
    const int n = static_cast<int>(points.size());
    Eigen::MatrixXd result(n, n);
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j <= i; ++j) {
        result(i, j) = result(j, i) = (at(points, i).position - at(points, j).position).norm();
      }
    }
    return result;
  }

  bool are_alike(double d_a, double d_b) const {
    const double tolerance = options_.distance_tolerance_m + options_.distance_tolerance_share * std::max(d_a, d_b);
    return std::min(d_a, d_b) > options_.min_distance_m && std::abs(d_a - d_b) < tolerance;
  }

  BitGraph consistency_graph() const {
    const std::size_t n = seeds_.size();
    BitGraph graph(n, Bits(n));
    for (std::size_t i = 0; i < n; ++i) {
      // Columns, since they lie in one piece.
      const auto d_a = distances_a_.col(seeds_[i].a), d_b = distances_b_.col(seeds_[i].b);
      for (std::size_t j = i + 1; j < n; ++j) {
        const NodePair& pair = seeds_[j];
        if (pair.a == seeds_[i].a || pair.b == seeds_[i].b || !are_alike(d_a(pair.a), d_b(pair.b))) continue;
        graph[i].set(j);
        graph[j].set(i);
      }
    }
    return graph;
  }

  /// Pairs without which a match puts the best one in no doubt.
  std::size_t least_beside(std::size_t best) const { return std::max(min_pairs_, (best + 1) / 2); }

  /// A largest clique and a greedy one about every correspondence, largest first, each once.
  std::vector<Clique> cliques(const BitGraph& graph) const {
    Clique largest = largest_clique(graph, kMaxCliqueSteps);
    if (largest.size() < min_pairs_) return {};
    const std::size_t least = least_beside(largest.size());
    std::vector<Clique> found{std::move(largest)};
    for (std::size_t i = 0; i < graph.size(); ++i) {
      if (graph[i].count_common(graph[i]) + 1 < least) continue;
      Clique clique = greedy_clique(graph, i, least);
      if (clique.size() >= least) found.push_back(std::move(clique));
    }
    std::sort(found.begin(), found.end(),
              [](const Clique& p, const Clique& q) { return p.size() != q.size() ? p.size() > q.size() : p < q; });
    found.erase(std::unique(found.begin(), found.end()), found.end());
    return found;
  }

  /// True if most of the clique already agrees with a match found, so that it would grow into the same.
  bool is_covered(const Clique& clique, const std::vector<GraphMatch>& matches) const {
    return std::any_of(matches.begin(), matches.end(), [&](const GraphMatch& match) {
      const Mat3 R = match.T_a_b.rotation();
      const auto agrees = [&](std::size_t i) {
        return residual(R, match.T_a_b.t, seeds_[i]) < options_.inlier_distance_m;
      };
      const auto agreeing = std::count_if(clique.begin(), clique.end(), agrees);
      return 4 * static_cast<std::size_t>(agreeing) > 3 * clique.size();
    });
  }

  double residual(const Mat3& R_a_b, const Vec3& t_a_b, const NodePair& pair) const {
    return (at(a_, pair.a).position - R_a_b * at(b_, pair.b).position - t_a_b).norm();
  }

  /// One-to-one, closest first.
  std::vector<NodePair> inliers(const SE3& T_a_b) const {
    const Mat3 R = T_a_b.rotation();
    std::vector<Vec3> turned;
    turned.reserve(b_.size());
    for (const LabelledPoint& point : b_) turned.push_back(R * point.position);
    std::vector<std::pair<double, std::size_t>> near;
    near.reserve(candidates_.size());
    for (std::size_t i = 0; i < candidates_.size(); ++i) {
      const NodePair& pair = candidates_[i];
      const double distance = (at(a_, pair.a).position - turned[static_cast<std::size_t>(pair.b)] - T_a_b.t).norm();
      if (distance < options_.inlier_distance_m) near.emplace_back(distance, i);
    }
    std::sort(near.begin(), near.end());
    std::vector<bool> used_a(a_.size(), false), used_b(b_.size(), false);
    std::vector<NodePair> pairs;
    pairs.reserve(near.size());
    for (const auto& [distance, i] : near) {
      const NodePair& pair = candidates_[i];
      if (used_a[static_cast<std::size_t>(pair.a)] || used_b[static_cast<std::size_t>(pair.b)]) continue;
      used_a[static_cast<std::size_t>(pair.a)] = used_b[static_cast<std::size_t>(pair.b)] = true;
      pairs.push_back(pair);
    }
    std::sort(pairs.begin(), pairs.end(), [](const NodePair& p, const NodePair& q) { return p.a < q.a; });
    return pairs;
  }

  /// @param min_pairs below which the clique is given up, for it would say nothing against the best match
  std::optional<GraphMatch> grow(const Clique& clique, std::size_t min_pairs) const {
    GraphMatch match;
    match.pairs.reserve(clique.size());
    for (const std::size_t i : clique) match.pairs.push_back(seeds_[i]);
    std::optional<Alignment> alignment = align(match.pairs, a_, b_);
    for (int round = 0; round < kRegrowRounds && alignment; ++round) {
      std::vector<NodePair> pairs = inliers(alignment->T_a_b);
      if (pairs.size() < min_pairs) return std::nullopt;
      const bool settled = pairs == match.pairs;
      match.pairs = std::move(pairs);
      if (settled) break;
      alignment = align(match.pairs, a_, b_);
    }
    if (!alignment) return std::nullopt;
    match.T_a_b = alignment->T_a_b;
    match.rms_m = alignment->rms_m;
    match.spread_m = alignment->spread_m();
    assess(&match);
    return match;
  }

  void assess(GraphMatch* match) const {
    std::vector<int> classes_a, classes_b;
    const Mat3 R = match->T_a_b.rotation();
    for (const NodePair& pair : match->pairs) {
      const double z = residual(R, match->T_a_b.t, pair) / (kScoreSigmaShare * options_.inlier_distance_m);
      match->score += std::exp(-0.5 * z * z);
      classes_a.push_back(at(a_, pair.a).class_id);
      classes_b.push_back(at(b_, pair.b).class_id);
    }
    match->classes =
        static_cast<int>(std::min(count_distinct(std::move(classes_a)), count_distinct(std::move(classes_b))));
  }

  /// Keeps the list sorted by score and free of near copies.
  void insert(GraphMatch match, std::vector<GraphMatch>* matches) const {
    const auto same = std::find_if(matches->begin(), matches->end(),
                                   [&](const GraphMatch& other) { return !are_distinct(b_, match, other); });
    if (same != matches->end()) {
      if (same->score >= match.score) return;
      matches->erase(same);
    }
    const auto position = std::find_if(matches->begin(), matches->end(),
                                       [&](const GraphMatch& other) { return other.score < match.score; });
    matches->insert(position, std::move(match));
  }

  const LoopOptions& options_;
  std::size_t min_pairs_;
  const std::vector<LabelledPoint>&a_, &b_;
  Eigen::MatrixXd distances_a_, distances_b_;
  std::vector<NodePair> candidates_, seeds_;  ///< that inliers, and cliques, are made of
};

std::vector<LabelledPoint> rescaled(std::vector<LabelledPoint> points, double scale) {
  for (LabelledPoint& point : points) {
    point.position *= scale;
    point.size *= scale;
  }
  return points;
}

/// Pairs of points by their labels, with the log of their distances; of very many of the same labels some, evenly
/// taken.
std::map<std::pair<int, int>, std::vector<double>> log_distances(const std::vector<LabelledPoint>& points,
                                                                 double min_distance_m) {
  std::map<std::pair<int, int>, std::vector<double>> distances;
  for (std::size_t i = 0; i < points.size(); ++i) {
    for (std::size_t j = i + 1; j < points.size(); ++j) {
      const double distance = (points[i].position - points[j].position).norm();
      if (!is_usable(points[i]) || !is_usable(points[j]) || !(distance > min_distance_m)) continue;
      distances[std::minmax({points[i].label, points[j].label})].push_back(std::log(distance));
    }
  }
  for (auto& [labels, logs] : distances) logs = evenly_taken(std::move(logs), kMaxSeeds);
  return distances;
}

/// The scales that most pairs of equal labels vote for, best first: peaks of a histogram of log(d_a / d_b).
std::vector<double> vote_scales(const std::vector<LabelledPoint>& a, const std::vector<LabelledPoint>& b,
                                double min_distance_m) {
  constexpr double kBin = 0.02;  ///< of log scale, a few to the error of two distances
  constexpr int kSpread = 4;     ///< bins to either side that a vote also supports: the error of two distances
  constexpr int kMaxPeaks = 3;   ///< each costs a matching
  const int half = static_cast<int>(std::ceil(std::log(kMaxScale) / kBin));
  std::vector<double> votes(static_cast<std::size_t>(2 * half + 1), 0.0);
  const auto of_b = log_distances(b, min_distance_m);
  for (const auto& [labels, logs_a] : log_distances(a, min_distance_m)) {
    const auto logs_b = of_b.find(labels);
    if (logs_b == of_b.end()) continue;
    for (const double log_a : logs_a) {
      for (const double log_b : logs_b->second) {
        const int middle = half + static_cast<int>(std::lround((log_a - log_b) / kBin));
        for (int k = -kSpread; k <= kSpread; ++k) {
          if (middle + k < 0 || middle + k > 2 * half) continue;
          votes[static_cast<std::size_t>(middle + k)] += 1.0 - std::abs(k) / (kSpread + 1.0);
        }
      }
    }
  }
  std::vector<double> scales;
  for (int peak = 0; peak < kMaxPeaks; ++peak) {
    const auto best = std::max_element(votes.begin(), votes.end());
    if (!(*best > 0.0)) break;
    const int bin = static_cast<int>(best - votes.begin());
    scales.push_back(std::exp((bin - half) * kBin));
    for (int k = std::max(bin - 2 * kSpread, 0); k <= std::min(bin + 2 * kSpread, 2 * half); ++k) {
      votes[static_cast<std::size_t>(k)] = 0.0;
    }
  }
  return scales;
}

/// Matches at a voted scale, then once more at the scale that the best match's inliers have.
std::vector<GraphMatch> match_scaled(const std::vector<LabelledPoint>& a, const std::vector<LabelledPoint>& b,
                                     double scale, const LoopOptions& options, int min_pairs) {
  std::vector<LabelledPoint> scaled = rescaled(b, scale);
  std::vector<GraphMatch> matches = Matching(options, min_pairs, a, scaled).run();
  if (matches.empty()) return matches;
  const std::optional<Alignment> alignment = align(matches.front().pairs, a, b, true);
  if (alignment && std::abs(std::log(alignment->scale)) < std::log(kMaxScale)) {
    scale = alignment->scale;
    scaled = rescaled(b, scale);
    matches = Matching(options, min_pairs, a, scaled).run();
  }
  for (GraphMatch& match : matches) match.scale = scale;
  return matches;
}

}  // namespace

Clique largest_clique(const BitGraph& graph, int max_steps) { return CliqueSearch(graph, max_steps).run(); }

Clique greedy_clique(const BitGraph& graph, std::size_t vertex, std::size_t least) {
  Bits candidates = graph[vertex];
  Clique clique;
  clique.reserve(kUsualClique);
  clique.push_back(vertex);
  while (candidates.any()) {
    std::size_t best = Bits::kNone, best_common = 0;
    for (std::size_t v = candidates.next(0); v != Bits::kNone; v = candidates.next(v + 1)) {
      const std::size_t count = candidates.count_common(graph[v]);
      if (best != Bits::kNone && count <= best_common) continue;
      best = v;
      best_common = count;
    }
    clique.push_back(best);
    if (clique.size() + best_common < least) break;
    candidates &= graph[best];
  }
  std::sort(clique.begin(), clique.end());
  return clique;
}

std::vector<GraphMatch> match_graphs(const std::vector<LabelledPoint>& a, const std::vector<LabelledPoint>& b,
                                     const LoopOptions& options, int min_pairs) {
  if (options.mode != "graph" || options.scale != "free") return Matching(options, min_pairs, a, b).run();
  std::vector<GraphMatch> matches;
  for (const double scale : vote_scales(a, b, options.min_distance_m)) {
    for (GraphMatch& match : match_scaled(a, b, scale, options, min_pairs)) matches.push_back(std::move(match));
  }
  std::stable_sort(matches.begin(), matches.end(),
                   [](const GraphMatch& p, const GraphMatch& q) { return p.score > q.score; });
  std::vector<GraphMatch> distinct;
  for (GraphMatch& match : matches) {
    const bool known = std::any_of(distinct.begin(), distinct.end(),
                                   [&](const GraphMatch& better) { return !are_distinct(b, match, better); });
    if (!known) distinct.push_back(std::move(match));
  }
  if (distinct.size() > kMaxMatches) distinct.resize(kMaxMatches);
  return distinct;
}

}  // namespace semantic_topo_loop::core
