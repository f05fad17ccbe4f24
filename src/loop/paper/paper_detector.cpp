#include "loop/paper/paper_detector.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kMinVector = 1e-6;  ///< m; two nodes in one place have no direction

bool is_usable(const CommonNode& start, const CommonNode& end) {
  const double query = (end.center_query - start.center_query).norm();
  const double match = (end.center_match - start.center_match).norm();
  return query > kMinVector && match > kMinVector;  // false for NaN as well
}

/// Calls f(end) for every other node to which a semantic vector leads from `start`.
template <class F>
void for_each_vector(const std::vector<CommonNode>& nodes, const CommonNode& start, F f) {
  for (const CommonNode& end : nodes) {
    if (&start != &end && is_usable(start, end)) f(end);
  }
}

/// Matches of consecutive keyframes belong together if they are this close in time.
constexpr std::int64_t kStreakSpan_ns = 4'000'000'000;

/// Few common nodes determine the pose poorly; shared landmarks say that the place is right all the same, so the edge
/// is kept with its wide covariance.
LoopOptions with_vague_edges(LoopOptions options) {
  options.max_sigma_m *= kPaperVagueness;
  options.max_sigma_deg *= kPaperVagueness;
  return options;
}

}  // namespace

Mat3 rotation_between(const Vec3& from, const Vec3& to) {
  const Vec3 a = from.normalized(), b = to.normalized();
  const Vec3 cross = a.cross(b);
  const double sine = cross.norm(), cosine = a.dot(b);
  if (sine > 1e-9) {
    const Mat3 K = hat(cross / sine);
    return Mat3::Identity() + sine * K + (1.0 - cosine) * K * K;
  }
  if (cosine > 0.0) return Mat3::Identity();
  int least = 0;
  a.cwiseAbs().minCoeff(&least);
  const Vec3 axis = a.cross(Vec3::Unit(least)).normalized();
  return 2.0 * axis * axis.transpose() - Mat3::Identity();
}

VectorTransform vector_transform(const CommonNode& start, const CommonNode& end) {
  const Vec3 query = end.center_query - start.center_query;
  const Vec3 match = end.center_match - start.center_match;
  VectorTransform transform;
  transform.R = rotation_between(query, match);
  transform.scale = match.norm() / query.norm();
  transform.angle_rad = std::atan2(query.cross(match).norm(), query.dot(match));
  transform.t = start.center_match - transform.scale * transform.R * start.center_query;
  return transform;
}

double printed_score(const std::vector<CommonNode>& nodes) {
  constexpr double kRotationNorm = 1.0;  // spectral norm of any rotation
  double score = 0.0, semantic = 0.0;
  for (const CommonNode& start : nodes) {
    const double t_m = (start.center_match - start.center_query).norm();
    for_each_vector(nodes, start, [&](const CommonNode& end) {
      const double topology = std::exp(-0.5 * std::abs(1.0 - vector_transform(start, end).scale * kRotationNorm - t_m));
      semantic += start.quality * topology;
    });
    score += semantic;
  }
  return score;
}

double corrected_score(const std::vector<CommonNode>& nodes) {
  double sum = 0.0;
  int vectors = 0;
  for (const CommonNode& start : nodes) {
    for_each_vector(nodes, start, [&](const CommonNode& end) {
      const VectorTransform vector = vector_transform(start, end);
      sum += start.quality * std::exp(-0.5 * (std::abs(1.0 - vector.scale) + vector.angle_rad + vector.t.norm()));
      ++vectors;
    });
  }
  return vectors > 0 ? sum / vectors : 0.0;
}

void ObjectIndex::insert(int keyframe, const std::vector<std::int64_t>& landmark_ids) {
  for (const std::int64_t id : landmark_ids) {
    std::vector<int>& keyframes = keyframes_of_[id];
    if (keyframes.empty() || keyframes.back() != keyframe) keyframes.push_back(keyframe);
  }
}

std::map<int, int> ObjectIndex::query(const std::vector<std::int64_t>& landmark_ids,
                                      const LandmarkRedirects& redirects) const {
  std::set<std::int64_t> landmarks;
  for (const std::int64_t id : landmark_ids) landmarks.insert(redirects.resolve(id));
  std::map<int, int> common;
  for (const std::int64_t landmark : landmarks) {
    std::set<int> keyframes;
    for (const std::int64_t id : redirects.aliases(landmark)) {
      const auto it = keyframes_of_.find(id);
      if (it != keyframes_of_.end()) keyframes.insert(it->second.begin(), it->second.end());
    }
    for (const int keyframe : keyframes) ++common[keyframe];
  }
  return common;
}

PaperDetector::PaperDetector(const LoopOptions& options, const LandmarkRedirects& redirects)
    : options_(with_vague_edges(options)), redirects_(redirects) {}

void PaperDetector::set_options(const LoopOptions& options) { options_ = with_vague_edges(options); }

void PaperDetector::apply(const MapUpdate& update) {
  for (const Landmark& landmark : update.changed) quality_[landmark.id] = landmark.quality;
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
    const auto [it, inserted] = keyframe.object_of_landmark.emplace(map.object(i).landmark_id, i);
    if (!inserted && map.object(i).frames_seen > map.object(it->second).frames_seen) it->second = i;
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
    const LocalObject& node = query.map.object(pair.b);
    const auto quality = quality_.find(redirects_.resolve(node.landmark_id));
    nodes.push_back({node.spheroid.center, match.map.object(pair.a).spheroid.center,
                     quality == quality_.end() ? 0.0 : quality->second});
  }
  return options_.score == "printed" ? printed_score(nodes) : corrected_score(nodes);
}

std::optional<PaperDetector::Scored> PaperDetector::best_candidate(const Keyframe& query) const {
  std::vector<std::int64_t> ids;
  for (const auto& [id, index] : query.object_of_landmark) ids.push_back(id);
  std::optional<Scored> best;
  for (const auto& [keyframe, common] : index_.query(ids, redirects_)) {
    const Keyframe& match = keyframes_[static_cast<std::size_t>(keyframe)];
    if (common < options_.paper_min_common) continue;
    if (query.map.frame_id - match.map.frame_id < options_.paper_min_gap_frames) continue;
    const double value = score(match, query);
    if (!best || value > best->score) {
      best = Scored{keyframe, common, value, best ? best->score : 0.0};
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
  const bool continues = streak_ > 0 && std::abs(match_stamp_ns - streak_match_ns_) <= kStreakSpan_ns &&
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
    const LocalObject& in_match = match.map.object(common[static_cast<std::size_t>(k)].a);
    const LocalObject& in_query = query.map.object(common[static_cast<std::size_t>(k)].b);
    points_match.push_back({in_match.spheroid.center, k, in_match.spheroid.radius(), in_match.class_id});
    points_query.push_back({in_query.spheroid.center, k, in_query.spheroid.radius(), in_query.class_id});
  }
  std::vector<GraphMatch> alignments = match_graphs(points_match, points_query, options_, options_.paper_min_common);
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
  refine_and_decide(match.map, query.map, alignment, false, options_, loop);
}

}  // namespace semantic_topo_loop::core
