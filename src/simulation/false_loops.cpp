#include "semantic_topo_loop/simulation/false_loops.h"

#include <algorithm>

#include "semantic_topo_loop/simulation/random.h"

namespace semantic_topo_loop::core {
namespace {

LoopClosure make_loop(const KeyframePose& query, const KeyframePose& match, const FalseLoopOptions& options) {
  LoopClosure loop;
  loop.query_keyframe_id = query.keyframe_id;
  loop.match_keyframe_id = match.keyframe_id;
  loop.query_frame = loop.query_end = query.frame_id;
  loop.match_frame = loop.match_end = match.frame_id;
  loop.query_stamp_ns = query.stamp_ns;
  loop.match_stamp_ns = match.stamp_ns;
  loop.query_begin = std::max<std::int64_t>(0, query.frame_id - options.window_frames);
  loop.match_begin = std::max<std::int64_t>(0, match.frame_id - options.window_frames);
  loop.accepted = true;
  loop.reason = LoopReason::kAccepted;
  loop.covariance = options.covariance;
  return loop;
}

}  // namespace

std::vector<LoopClosure> make_false_loops(const std::vector<KeyframePose>& keyframes, const FalseLoopOptions& options,
                                          std::uint64_t seed) {
  const int size = static_cast<int>(keyframes.size()), gap = std::max(1, options.min_gap_keyframes);
  std::vector<LoopClosure> loops;
  if (size <= gap) return loops;
  Random random(seed);
  const auto keyframe = [&keyframes](int i) -> const KeyframePose& { return keyframes[static_cast<std::size_t>(i)]; };
  while (static_cast<int>(loops.size()) < options.count) {
    const int query = random.integer(gap, size - 1), match = random.integer(0, query - gap);
    const SE3 T_match_query(random.rotation(), options.distance_m * random.normal3());
    const int members = std::min(std::max(1, options.cluster_size), options.count - static_cast<int>(loops.size()));
    for (int i = 0; i < members; ++i) {
      const int next = std::min(query + i, size - 1);
      LoopClosure loop = make_loop(keyframe(next), keyframe(match), options);
      loop.T_match_query = T_match_query * (keyframe(query).T_map_camera.inverse() * keyframe(next).T_map_camera);
      loops.push_back(loop);
    }
  }
  std::stable_sort(loops.begin(), loops.end(),
                   [](const LoopClosure& a, const LoopClosure& b) { return a.query_frame < b.query_frame; });
  return loops;
}

}  // namespace semantic_topo_loop::core
