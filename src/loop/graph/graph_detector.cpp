#include "loop/graph/graph_detector.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <set>
#include <tuple>

#include "geometry/descriptor.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

/// Calls f(label, label, distance) for every pair of usable points.
template <class F>
void for_each_pair(const std::vector<LabelledPoint>& points, double min_distance_m, F f) {
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (points[i].label < 0) continue;
    for (std::size_t j = i + 1; j < points.size(); ++j) {
      const double distance = (points[i].position - points[j].position).norm();
      if (points[j].label < 0 || !(distance > min_distance_m) || !std::isfinite(distance)) continue;
      f(points[i].label, points[j].label, distance);
    }
  }
}

/// Objects of an alignment worth a verdict, and of a submap worth keeping: three fit somewhere in most places.
constexpr int kMinCandidateInliers = 4;
/// Agreeing pairs of objects of a submap that the index proposes: those of four objects.
constexpr int kMinEdges = kMinCandidateInliers * (kMinCandidateInliers - 1) / 2;
/// Of the shortest window: a submap shorter than that, after a break or at the start, is not kept.
constexpr double kMinSpanShare = 0.8;
/// Submaps that share more than this of their time tell of one place.
constexpr double kSamePlace = 0.5;
/// Submaps whose anchors are no farther apart see a place alike, as two visits that cannot be told apart do. So many of
/// them are enough: a handful of visits, of which each leaves one or two.
constexpr double kAlike_m = 1.0, kAlike_rad = 0.5;
constexpr std::size_t kEnough = 8;
/// An odometry without a noticed break is at most this wrong over a short time, jumps that nobody saw included.
constexpr double kMinDisagreement_m = 2.5;
constexpr double kDriftDepth_m = 2.0;  ///< of the usual object: turns apparent drift, an angle, into metres
constexpr double kDriftFactor = 2.0;   ///< on the drift observed, and what was missed of turns

std::vector<LabelledPoint> graph_of(const LocalMap& map) {
  std::vector<LabelledPoint> points;
  for (const LocalObject& object : map.objects) {
    points.push_back({object.spheroid.center, object.label, object.spheroid.radius(), object.class_id});
  }
  return points;
}

std::vector<std::uint32_t> words_of(const LocalMap& map) {
  std::vector<Descriptor> descriptors;
  if (map.features) {
    for (const PointFeature& feature : *map.features) descriptors.push_back(feature.descriptor);
  }
  return visual_words(descriptors);
}

/// The query in the match's unit of length; `scaled` holds it if that is another one.
const LocalMap& in_unit(const LocalMap& query, double scale, std::optional<LocalMap>* scaled) {
  return scale == 1.0 ? query : scaled->emplace(rescaled(query, scale));
}

/// What its stamps say of another session's clock means nothing here.
bool is_of_other_session(const LocalMap& map) { return map.segment < 0; }
double seconds_since(const LocalMap& earlier, const LocalMap& later) {
  return 1e-9 * static_cast<double>(later.stamp_ns - earlier.stamp_ns);
}

/// Share of the shorter window that two windows have in common.
double overlap(const LocalMap& p, const LocalMap& q) {
  const auto common = std::min(p.end_frame, q.end_frame) - std::max(p.begin_frame, q.begin_frame);
  const auto shorter = std::min(p.end_frame - p.begin_frame, q.end_frame - q.begin_frame);
  return static_cast<double>(common) / static_cast<double>(std::max<std::int64_t>(shorter, 1));
}

/// The query's pose in the odometry's world, had it not drifted since the match.
SE3 implied_pose(const LocalMap& match, const GraphMatch& alignment) { return match.T_odom_anchor * alignment.T_a_b; }

/// True if p and q are poses of the query by way of two submaps (or the query itself), between which the odometry
/// cannot have drifted that far: then the two speak of different places. Earlier sessions stand in one map, in which no
/// odometry drifts from one to the next.
bool are_apart(const LocalMap& map_p, const SE3& p, const LocalMap& map_q, const SE3& q) {
  if (map_p.segment != map_q.segment) return false;
  const double time_s = is_of_other_session(map_p) ? 0.0 : std::abs(seconds_since(map_p, map_q));
  const double turned_rad = std::max(map_p.drift_rad_s, map_q.drift_rad_s) * time_s +
                            std::abs(map_p.missed.rotation_rad - map_q.missed.rotation_rad);
  const double missed_m = std::abs(map_p.missed.translation_m - map_q.missed.translation_m);
  return (p.t - q.t).norm() > kMinDisagreement_m + kDriftFactor * kDriftDepth_m * turned_rad + missed_m;
}

}  // namespace

SubmapIndex::Key SubmapIndex::key(int label_p, int label_q, int bin) {
  const auto low = static_cast<Key>(std::min(label_p, label_q)), high = static_cast<Key>(std::max(label_p, label_q));
  return low << 40 | high << 20 | static_cast<Key>(bin);
}

int SubmapIndex::bin(double distance_m) const {
  constexpr double kMaxBin = 1e6;  // fits the 20 bits that a key has for it
  return static_cast<int>(std::min(std::max(distance_m, 0.0) / options_.distance_tolerance_m, kMaxBin));
}

void SubmapIndex::insert(const std::vector<LabelledPoint>& points) {
  for_each_pair(points, options_.min_distance_m, [this](int p, int q, double distance) {
    std::vector<int>& submaps = submaps_of_[key(p, q, bin(distance))];
    if (submaps.empty() || submaps.back() != size_) submaps.push_back(size_);
  });
  ++size_;
}

void SubmapIndex::erase(int number, const std::vector<LabelledPoint>& points) {
  for_each_pair(points, options_.min_distance_m, [this, number](int p, int q, double distance) {
    const auto entry = submaps_of_.find(key(p, q, bin(distance)));
    if (entry == submaps_of_.end()) return;
    std::vector<int>& submaps = entry->second;
    submaps.erase(std::remove(submaps.begin(), submaps.end(), number), submaps.end());
    if (submaps.empty()) submaps_of_.erase(entry);
  });
}

std::vector<int> SubmapIndex::agreeing_pairs(const std::vector<LabelledPoint>& points, int end) const {
  std::vector<int> edges(static_cast<std::size_t>(std::max(end, 0)), 0);
  std::vector<int> last_pair(edges.size(), -1);
  int pair = 0;
  for_each_pair(points, options_.min_distance_m, [&](int p, int q, double distance) {
    const double tolerance = options_.distance_tolerance_m + options_.distance_tolerance_share * distance;
    for (int b = bin(distance - tolerance); b <= bin(distance + tolerance); ++b) {
      const auto entry = submaps_of_.find(key(p, q, b));
      if (entry == submaps_of_.end()) continue;
      for (const int submap : entry->second) {
        if (submap >= end) break;
        int& last = last_pair[static_cast<std::size_t>(submap)];
        if (last == pair) continue;
        last = pair;
        ++edges[static_cast<std::size_t>(submap)];
      }
    }
    ++pair;
  });
  return edges;
}

std::vector<int> SubmapIndex::query(const std::vector<LabelledPoint>& points, int end) const {
  const std::vector<int> edges = agreeing_pairs(points, end);
  std::vector<int> candidates;
  for (int submap = 0; submap < end; ++submap) {
    if (edges[static_cast<std::size_t>(submap)] >= kMinEdges) candidates.push_back(submap);
  }
  if (static_cast<int>(candidates.size()) > max_returned_) {
    std::stable_sort(candidates.begin(), candidates.end(), [&edges](int p, int q) {
      return edges[static_cast<std::size_t>(p)] > edges[static_cast<std::size_t>(q)];
    });
    candidates.resize(static_cast<std::size_t>(max_returned_));
    std::sort(candidates.begin(), candidates.end());
  }
  return candidates;
}

GraphDetector::GraphDetector(const LoopOptions& options) : options_(options), index_(options) {}

int GraphDetector::old_enough(const LocalMap& query) const {
  // From the latest back, since those that are kept by themselves come in order of time.
  int end = index_.size();
  for (auto stored = maps_.rbegin(); stored != maps_.rend(); ++stored) {
    const LocalMap& map = stored->second.map;
    if (is_of_other_session(map) || seconds_since(map, query) >= options_.min_gap_s) break;
    end = stored->first;
  }
  return end;
}

/// With a free scale the index is asked at every scale that its tolerance tells from the next.
std::vector<int> GraphDetector::propose(const std::vector<LabelledPoint>& points, int end) const {
  if (options_.scale != "free") return index_.query(points, end);
  // Of log scale: at a distance of a metre the tolerances of 0.06 m + 0.03 cover 9 %, so that no scale falls between.
  constexpr double kStep = 0.08;
  const int steps = static_cast<int>(std::ceil(std::log(kMaxScale) / kStep));
  std::set<int> numbers;
  for (int k = -steps; k <= steps; ++k) {
    std::vector<LabelledPoint> scaled = points;
    for (LabelledPoint& point : scaled) point.position *= std::exp(k * kStep);
    for (const int number : index_.query(scaled, end)) numbers.insert(number);
  }
  return {numbers.begin(), numbers.end()};
}

std::vector<LoopClosure> GraphDetector::detect(const LocalMap& query) {
  const std::vector<LabelledPoint> points = graph_of(query);
  std::vector<Candidate> candidates = examine(query, points, propose(points, old_enough(query)));
  find_ambiguous(query, &candidates);
  select(&candidates);
  std::vector<LoopClosure> loops;
  for (const Candidate& candidate : candidates) {
    if (is_accepted(candidate)) mark_compared(match_of(candidate), query.end_ns);
    loops.push_back(finish(query, candidate));
  }
  const bool is_found = std::any_of(loops.begin(), loops.end(), [](const LoopClosure& loop) { return loop.accepted; });
  if (is_found) return loops;
  if (std::optional<LoopClosure> loop = find_by_points(query)) loops.push_back(*std::move(loop));
  return loops;
}

/// In its own part of the odometry the front end looks for places of long ago itself, in every keyframe.
std::optional<LoopClosure> GraphDetector::find_by_points(const LocalMap& query) const {
  constexpr std::size_t kTried = 3;  // bounds the time of a query
  if (!query.features) return std::nullopt;
  const std::vector<int> common = words_.common(words_of(query));
  std::vector<std::pair<int, int>> alike;
  for (const auto& [number, stored] : maps_) {
    if (stored.map.segment != query.segment) alike.emplace_back(common.at(static_cast<std::size_t>(number)), number);
  }
  std::sort(alike.rbegin(), alike.rend());
  alike.resize(std::min(alike.size(), kTried));
  for (const auto& [words, number] : alike) {
    const LocalMap& match = maps_.at(number).map;
    LoopClosure loop = make_closure(match, query);
    decide_by_points(match, query, &loop);
    loop.tilt_deg = degrees(tilt(match, query, loop.T_match_query));
    if (loop.accepted && loop.tilt_deg <= options_.max_tilt_deg) return loop;
  }
  return std::nullopt;
}

void GraphDetector::store(LocalMap map) {
  if (static_cast<int>(map.objects.size()) < kMinCandidateInliers) return;
  if (map.span_s < kMinSpanShare * options_.min_window_s) return;
  if (!maps_.empty()) {
    const LocalMap& last = maps_.rbegin()->second.map;
    if (!is_of_other_session(last) && seconds_since(last, map) < options_.store_interval_s) return;
  }
  make_room(map);
  insert(std::move(map));
}

void GraphDetector::make_room(const LocalMap& map) {
  const std::vector<int> alike = find_alike(map);
  if (alike.size() < kEnough) return;
  const int poorest = *std::min_element(alike.begin(), alike.end(), [this](int p, int q) {
    return maps_.at(p).points.size() < maps_.at(q).points.size();
  });
  index_.erase(poorest, maps_.at(poorest).points);
  words_.erase(poorest, words_of(maps_.at(poorest).map));
  maps_.erase(poorest);
}

std::vector<int> GraphDetector::find_alike(const LocalMap& map) const {
  const std::vector<LabelledPoint> points = graph_of(map);
  // With as many objects in common as a loop needs, or all that one of the two has.
  const auto is_alike = [this, &points](const GraphMatch& match, std::size_t objects) {
    const std::size_t enough = std::min({static_cast<std::size_t>(options_.min_inliers), points.size(), objects});
    return match.pairs.size() >= enough && match.T_a_b.t.norm() <= kAlike_m &&
           rotation_angle(match.T_a_b.q, Quaternion::Identity()) <= kAlike_rad;
  };
  std::vector<int> alike;
  for (const int number : propose(points, old_enough(map))) {
    const std::vector<LabelledPoint>& stored = maps_.at(number).points;
    const std::vector<GraphMatch> matches = match_graphs(stored, points, options_, kMinCandidateInliers);
    if (!matches.empty() && is_alike(matches.front(), stored.size())) alike.push_back(number);
  }
  return alike;
}

void GraphDetector::insert(LocalMap map) {
  std::vector<LabelledPoint> points = graph_of(map);
  words_.insert(index_.size(), words_of(map));
  maps_.emplace(index_.size(), StoredMap{std::move(map), points});
  index_.insert(points);
}

std::optional<int> GraphDetector::submap_about(std::int64_t frame_id, std::int64_t stamp_ns) const {
  std::optional<int> best;
  for (const auto& [number, stored] : maps_) {
    const LocalMap& map = stored.map;
    if (frame_id < map.begin_frame || frame_id > map.end_frame) continue;
    if (!best || std::abs(map.stamp_ns - stamp_ns) < std::abs(maps_.at(*best).map.stamp_ns - stamp_ns)) best = number;
  }
  return best;
}

GraphDetector::Comparison GraphDetector::compare(int query, int match) const {
  const StoredMap& stored = maps_.at(query);
  // Of an earlier session's all the others are old enough, those that came after it too.
  const int end = std::max(std::min(old_enough(stored.map), query), match + 1);
  Comparison comparison;
  comparison.agreeing_pairs = index_.agreeing_pairs(stored.points, end)[static_cast<std::size_t>(match)];
  std::vector<int> numbers = propose(stored.points, end);
  comparison.proposed = std::binary_search(numbers.begin(), numbers.end(), match);
  if (!comparison.proposed) numbers.push_back(match);
  std::vector<Candidate> candidates = examine(stored.map, stored.points, numbers);
  find_ambiguous(stored.map, &candidates);
  for (const Candidate& candidate : candidates) {
    if (candidate.stored == match) comparison.closure = finish(stored.map, candidate);
  }
  return comparison;
}

std::vector<GraphDetector::Candidate> GraphDetector::examine(const LocalMap& query,
                                                             const std::vector<LabelledPoint>& points,
                                                             const std::vector<int>& numbers) const {
  std::vector<Candidate> candidates;
  for (const int number : numbers) {
    Candidate candidate;
    candidate.stored = number;
    std::vector<GraphMatch> matches = match_graphs(maps_.at(number).points, points, options_, kMinCandidateInliers);
    if (matches.empty()) continue;
    candidate.second_score = matches.size() > 1 ? matches[1].score : 0.0;
    candidate.alignment = std::move(matches.front());
    std::optional<LocalMap> scaled;
    candidate.verdict = verify_alignment(match_of(candidate), in_unit(query, candidate.alignment.scale, &scaled),
                                         candidate.alignment, candidate.second_score, options_);
    candidates.push_back(std::move(candidate));
  }
  return candidates;
}

/// Abstains where two places look alike: two submaps that the query fits nearly as well, or the submap and the place
/// where an unbroken odometry sees itself, too far apart for drift. The odometry decides nothing else. Few objects,
/// whose surfaces nobody has looked at yet, speak against few only.
void GraphDetector::find_ambiguous(const LocalMap& query, std::vector<Candidate>* candidates) const {
  std::vector<Candidate*> accepted;
  for (Candidate& candidate : *candidates) {
    if (is_accepted(candidate)) accepted.push_back(&candidate);
  }
  for (Candidate* candidate : accepted) {
    const LocalMap& match = match_of(*candidate);
    const SE3 pose = implied_pose(match, candidate->alignment);
    bool ambiguous = are_apart(match, pose, query, query.T_odom_anchor);
    for (const Candidate* other : accepted) {
      if (has_few(*other) && !has_few(*candidate)) continue;
      if (options_.ambiguity_ratio * other->alignment.score < candidate->alignment.score) continue;
      if (!are_apart(match, pose, match_of(*other), implied_pose(match_of(*other), other->alignment))) continue;
      candidate->second_score = std::max(candidate->second_score, other->alignment.score);
      ambiguous = true;
    }
    if (ambiguous) candidate->verdict.reason = LoopReason::kAmbiguous;
  }
}

/// The best of every place: submaps that overlap in time tell of one place, accepted ones first, of these those with
/// enough objects by themselves, then by score. After the very best come the places that were compared least recently,
/// since they say more than the same loop once more. Those beyond `max_candidates` and those of a place that has a
/// better one are outranked, and come last.
void GraphDetector::select(std::vector<Candidate>* candidates) const {
  const auto rank = [this](const Candidate& candidate) {
    return std::make_tuple(!is_accepted(candidate), has_few(candidate), -candidate.alignment.score);
  };
  std::stable_sort(candidates->begin(), candidates->end(),
                   [&](const Candidate& p, const Candidate& q) { return rank(p) < rank(q); });
  std::vector<Candidate> places, others;
  for (Candidate& candidate : *candidates) {
    const bool repeats = std::any_of(places.begin(), places.end(), [&](const Candidate& other) {
      return overlap(match_of(candidate), match_of(other)) > kSamePlace;
    });
    (repeats ? others : places).push_back(std::move(candidate));
  }
  const auto rejected = std::find_if_not(places.begin(), places.end(), is_accepted);
  if (rejected - places.begin() > 2) {
    std::stable_sort(places.begin() + 1, rejected, [this](const Candidate& p, const Candidate& q) {
      return maps_.at(p.stored).compared_ns < maps_.at(q.stored).compared_ns;
    });
  }
  const std::size_t kept = std::min(places.size(), static_cast<std::size_t>(options_.max_candidates));
  std::move(others.begin(), others.end(), std::back_inserter(places));
  for (std::size_t i = kept; i < places.size(); ++i) {
    if (is_accepted(places[i])) places[i].verdict.reason = LoopReason::kOutranked;
  }
  *candidates = std::move(places);
}

void GraphDetector::mark_compared(const LocalMap& match, std::int64_t query_ns) {
  for (auto& [number, stored] : maps_) {
    if (overlap(stored.map, match) > kSamePlace) stored.compared_ns = query_ns;
  }
}

LoopClosure GraphDetector::finish(const LocalMap& query, const Candidate& candidate) const {
  LoopClosure loop = make_closure(match_of(candidate), query);
  set_alignment(match_of(candidate), query, candidate.alignment, &loop);
  loop.reason = candidate.verdict.reason;
  loop.score = candidate.alignment.score;
  loop.second_score = candidate.second_score;
  loop.tilt_deg = candidate.verdict.tilt_deg;
  if (const std::optional<Reprojection>& reprojection = candidate.verdict.reprojection) {
    loop.reprojection_ratio = reprojection->ratio;
    loop.reprojected_objects = reprojection->objects;
    loop.explained_share = reprojection->explained;
  }
  if (loop.reason == LoopReason::kAccepted) {
    std::optional<LocalMap> scaled;
    refine_and_decide(match_of(candidate), in_unit(query, candidate.alignment.scale, &scaled), candidate.alignment,
                      has_few(candidate), options_, &loop);
  }
  return loop;
}

}  // namespace semantic_topo_loop::core
