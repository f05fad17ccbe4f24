#include "semantic_topo_loop/loop/graph_detector.h"

#include <algorithm>
#include <cmath>

#include "loop_evidence.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kMinCandidateInliers = 4;
/// Of the window: a submap shorter than that, after a break or at the start, is not kept.
constexpr double kMinSpanShare = 0.5;

GraphMatcherOptions matcher_options(const LoopOptions& options) {
  GraphMatcherOptions matcher;
  matcher.size_ratio_log = options.size_ratio_log;
  matcher.distance_tolerance_m = options.distance_tolerance_m;
  matcher.distance_tolerance_share = options.distance_tolerance_share;
  matcher.min_distance_m = options.min_distance_m;
  matcher.inlier_distance_m = options.inlier_distance_m;
  matcher.min_pairs = kMinCandidateInliers;
  return matcher;
}

std::vector<LabelledPoint> graph_of(const LocalMap& map) {
  std::vector<LabelledPoint> points;
  for (const LocalObject& object : map.objects) {
    points.push_back({object.spheroid.center, object.label, object.spheroid.radius(), object.class_id});
  }
  return points;
}

/// Share of the shorter window that two windows have in common.
double overlap(const LocalMap& p, const LocalMap& q) {
  const auto common = std::min(p.end_frame, q.end_frame) - std::max(p.begin_frame, q.begin_frame);
  const auto shorter = std::min(p.end_frame - p.begin_frame, q.end_frame - q.begin_frame);
  return static_cast<double>(common) / static_cast<double>(std::max<std::int64_t>(shorter, 1));
}

}  // namespace

GraphDetector::GraphDetector(const LoopOptions& options)
    : options_(options), matcher_(matcher_options(options)), verifier_(options), refiner_(options) {}

std::vector<LoopClosure> GraphDetector::detect(const LocalMap& query) const {
  std::vector<LoopClosure> loops;
  const std::vector<LabelledPoint> points = graph_of(query);
  std::vector<Candidate> candidates;
  for (std::size_t i = 0; i < maps_.size(); ++i) {
    if (static_cast<double>(query.stamp_ns - maps_[i].stamp_ns) < 1e9 * options_.min_gap_s) break;
    if (auto candidate = examine(query, points, i)) candidates.push_back(std::move(*candidate));
  }
  select(&candidates);
  for (const Candidate& candidate : candidates) loops.push_back(finish(query, candidate));
  return loops;
}

void GraphDetector::store(LocalMap map) {
  if (static_cast<int>(map.objects.size()) < kMinCandidateInliers) return;
  if (map.span_s < kMinSpanShare * options_.window_s) return;
  const bool due =
      maps_.empty() || static_cast<double>(map.stamp_ns - maps_.back().stamp_ns) >= 1e9 * options_.store_interval_s;
  if (!due) return;
  points_.push_back(graph_of(map));
  maps_.push_back(std::move(map));
}

std::optional<GraphDetector::Candidate> GraphDetector::examine(const LocalMap& query,
                                                               const std::vector<LabelledPoint>& points,
                                                               std::size_t stored) const {
  std::vector<GraphMatch> matches = matcher_.match(points_[stored], points);
  if (matches.empty()) return std::nullopt;
  Candidate candidate;
  candidate.match = &maps_[stored];
  candidate.second_score = matches.size() > 1 ? matches[1].score : 0.0;
  candidate.alignment = std::move(matches.front());
  candidate.verdict = verifier_.verify(*candidate.match, query, candidate.alignment, candidate.second_score);
  return candidate;
}

/// The best of every place: submaps that overlap in time tell of one place, accepted ones first, then by score.
void GraphDetector::select(std::vector<Candidate>* candidates) const {
  std::stable_sort(candidates->begin(), candidates->end(), [](const Candidate& p, const Candidate& q) {
    const bool p_accepted = p.verdict.reason == LoopReason::kAccepted;
    const bool q_accepted = q.verdict.reason == LoopReason::kAccepted;
    return p_accepted != q_accepted ? p_accepted : p.alignment.score > q.alignment.score;
  });
  std::vector<Candidate> selected;
  for (Candidate& candidate : *candidates) {
    if (static_cast<int>(selected.size()) == options_.max_candidates) break;
    const bool repeats = std::any_of(selected.begin(), selected.end(), [&](const Candidate& other) {
      return overlap(*candidate.match, *other.match) > 0.5;
    });
    if (!repeats) selected.push_back(std::move(candidate));
  }
  *candidates = std::move(selected);
}

LoopClosure GraphDetector::finish(const LocalMap& query, const Candidate& candidate) const {
  LoopClosure loop = make_closure(*candidate.match, query);
  set_alignment(*candidate.match, query, candidate.alignment, &loop);
  loop.reason = candidate.verdict.reason;
  loop.score = candidate.alignment.score;
  loop.second_score = candidate.second_score;
  loop.reprojection_ratio = candidate.verdict.reprojection.ratio;
  if (loop.reason == LoopReason::kAccepted) {
    refine_and_decide(*candidate.match, query, candidate.alignment, refiner_, options_, &loop);
  }
  return loop;
}

}  // namespace semantic_topo_loop::core
