#include "loop/paper/paper_detector.h"

#include <algorithm>
#include <cmath>

#include "loop/graph/loop_evidence.h"

namespace semantic_topo_loop::core {
namespace {

/// Matches of consecutive keyframes belong together if they are this close in time.
constexpr std::int64_t kStreakSpanNs = 4'000'000'000;

GraphMatcherOptions matcher_options(const LoopOptions& options) {
  GraphMatcherOptions matcher;
  matcher.size_ratio_log = options.size_ratio_log;
  matcher.distance_tolerance_m = options.distance_tolerance_m;
  matcher.distance_tolerance_share = options.distance_tolerance_share;
  matcher.min_distance_m = options.min_distance_m;
  matcher.inlier_distance_m = options.inlier_distance_m;
  matcher.min_pairs = options.paper_min_common;
  matcher.max_matches = 1;
  return matcher;
}

/// Few common nodes determine the pose poorly; shared landmarks say that the place is right all the same, so the edge
/// is kept with its wide covariance.
LoopOptions with_vague_edges(LoopOptions options) {
  constexpr double kVagueness = 3.0;
  options.max_sigma_m *= kVagueness;
  options.max_sigma_deg *= kVagueness;
  return options;
}

const LocalObject& object(const LocalMap& map, int i) { return map.objects[static_cast<std::size_t>(i)]; }

}  // namespace

PaperDetector::PaperDetector(const LoopOptions& options)
    : options_(with_vague_edges(options)), matcher_(matcher_options(options)), refiner_(options) {}

void PaperDetector::apply(const MapUpdate& update) {
  for (const Landmark& landmark : update.changed) quality_[landmark.id] = landmark.quality;
  redirects_.apply(update);
  for (const LandmarkMerge& merge : update.merged) quality_.erase(merge.merged_id);
  for (const std::int64_t id : update.removed) quality_.erase(id);
}

std::vector<LoopClosure> PaperDetector::detect(LocalMap map, bool search) {
  std::vector<LoopClosure> loops;
  // The window's middle keyframe may still be the one of the last call.
  if (!keyframes_.empty() && keyframes_.back().map.keyframe_id >= map.keyframe_id) return loops;
  Keyframe query = make_keyframe(std::move(map));
  if (search) {
    const std::optional<Scored> best = best_candidate(query);
    if (best) {
      loops.push_back(judge(query, *best));
    } else {
      streak_ = 0;
    }
  }
  std::vector<std::int64_t> ids;
  for (const auto& [id, index] : query.object_of_landmark) ids.push_back(id);
  index_.insert(static_cast<int>(keyframes_.size()), ids);
  keyframes_.push_back(std::move(query));
  return loops;
}

PaperDetector::Keyframe PaperDetector::make_keyframe(LocalMap map) const {
  Keyframe keyframe;
  for (int i = 0; i < static_cast<int>(map.objects.size()); ++i) {
    const auto [it, inserted] = keyframe.object_of_landmark.emplace(object(map, i).landmark_id, i);
    if (!inserted && object(map, i).frames_seen > object(map, it->second).frames_seen) it->second = i;
  }
  keyframe.map = std::move(map);
  return keyframe;
}

std::vector<NodePair> PaperDetector::common_objects(const Keyframe& match, const Keyframe& query) const {
  std::map<std::int64_t, int> match_object;
  for (const auto& [id, index] : match.object_of_landmark) match_object.emplace(redirects_.resolve(id), index);
  std::vector<NodePair> common;
  for (const auto& [id, index] : query.object_of_landmark) {
    const auto it = match_object.find(redirects_.resolve(id));
    if (it != match_object.end()) common.push_back({it->second, index});
  }
  return common;
}

double PaperDetector::score(const Keyframe& match, const Keyframe& query) const {
  std::vector<CommonNode> nodes;
  for (const NodePair& pair : common_objects(match, query)) {
    const LocalObject& node = object(query.map, pair.b);
    const auto quality = quality_.find(redirects_.resolve(node.landmark_id));
    nodes.push_back({node.spheroid.center, object(match.map, pair.a).spheroid.center,
                     quality == quality_.end() ? 0.0 : quality->second});
  }
  return options_.score == "printed" ? printed_score(nodes) : corrected_score(nodes);
}

std::optional<PaperDetector::Scored> PaperDetector::best_candidate(const Keyframe& query) const {
  std::vector<std::int64_t> ids;
  for (const auto& [id, index] : query.object_of_landmark) ids.push_back(id);
  std::optional<Scored> best;
  for (const KeyframeCandidate& candidate : index_.query(ids, redirects_, options_.paper_min_common)) {
    const Keyframe& match = keyframes_[static_cast<std::size_t>(candidate.keyframe)];
    if (query.map.frame_id - match.map.frame_id < options_.paper_min_gap_frames) continue;
    const double value = score(match, query);
    if (!best || value > best->score) {
      best = Scored{candidate.keyframe, candidate.common, value, best ? best->score : 0.0};
    } else {
      best->second_score = std::max(best->second_score, value);
    }
  }
  return best;
}

LoopClosure PaperDetector::judge(const Keyframe& query, const Scored& best) {
  const Keyframe& match = keyframes_[static_cast<std::size_t>(best.keyframe)];
  LoopClosure loop = make_closure(match.map, query.map);
  loop.score = best.score;
  loop.second_score = best.second_score;
  loop.inliers = best.common;
  const double threshold =
      options_.score == "printed" ? options_.paper_printed_min_score : options_.paper_corrected_min_score;
  if (best.score < threshold) {
    loop.reason = LoopReason::kLowScore;
    streak_ = 0;
    return loop;
  }
  const bool consistent = is_consistent(query, match.map.stamp_ns);
  align(match, query, &loop);
  if (loop.accepted && !consistent) {
    loop.accepted = false;
    loop.reason = LoopReason::kInconsistent;
  }
  return loop;
}

bool PaperDetector::is_consistent(const Keyframe& query, std::int64_t match_stamp_ns) {
  const bool continues = streak_ > 0 && std::abs(match_stamp_ns - streak_match_ns_) <= kStreakSpanNs &&
                         !keyframes_.empty() && keyframes_.back().map.keyframe_id == streak_keyframe_id_;
  streak_ = continues ? streak_ + 1 : 1;
  streak_match_ns_ = match_stamp_ns;
  streak_keyframe_id_ = query.map.keyframe_id;
  return streak_ >= options_.paper_consistency;
}

/// The loop edge: rigid alignment of the common nodes' centres, refined on boxes. Each common landmark has a label of
/// its own, so that the matcher's clique leaves out those whose association is wrong on one side.
void PaperDetector::align(const Keyframe& match, const Keyframe& query, LoopClosure* loop) const {
  const std::vector<NodePair> common = common_objects(match, query);
  std::vector<LabelledPoint> points_match, points_query;
  for (int k = 0; k < static_cast<int>(common.size()); ++k) {
    const Spheroid& in_match = object(match.map, common[static_cast<std::size_t>(k)].a).spheroid;
    const Spheroid& in_query = object(query.map, common[static_cast<std::size_t>(k)].b).spheroid;
    points_match.push_back({in_match.center, k, in_match.radius()});
    points_query.push_back({in_query.center, k, in_query.radius()});
  }
  std::vector<GraphMatch> alignments = matcher_.match(points_match, points_query);
  if (alignments.empty() || alignments.front().spread_m(1) < options_.min_spread_m) {
    loop->reason = LoopReason::kDegenerate;
    return;
  }
  GraphMatch& alignment = alignments.front();
  for (NodePair& pair : alignment.pairs) pair = common[static_cast<std::size_t>(pair.a)];
  set_alignment(match.map, query.map, alignment, loop);
  if (alignment.rms_m > options_.max_rms_m) {
    loop->reason = LoopReason::kResidual;
    return;
  }
  refine_and_decide(match.map, query.map, alignment, refiner_, options_, loop);
}

}  // namespace semantic_topo_loop::core
