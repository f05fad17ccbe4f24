#include "semantic_topo_loop/loop/keyframe_queue.h"

#include <algorithm>
#include <iterator>

namespace semantic_topo_loop::core {

void ObjectIndex::insert(int keyframe, const std::vector<std::int64_t>& landmark_ids) {
  for (const std::int64_t id : landmark_ids) {
    std::vector<int>& keyframes = keyframes_of_[id];
    if (keyframes.empty() || keyframes.back() != keyframe) keyframes.push_back(keyframe);
  }
}

void ObjectIndex::merge(std::int64_t merged_id, std::int64_t survivor_id) {
  const auto merged = keyframes_of_.find(merged_id);
  if (merged == keyframes_of_.end() || merged_id == survivor_id) return;
  const std::vector<int>& survivor = keyframes_of_[survivor_id];
  std::vector<int> both;
  std::set_union(merged->second.begin(), merged->second.end(), survivor.begin(), survivor.end(),
                 std::back_inserter(both));
  keyframes_of_[survivor_id] = std::move(both);
  keyframes_of_.erase(merged);
}

std::vector<KeyframeCandidate> ObjectIndex::query(const std::vector<std::int64_t>& landmark_ids, int min_common) const {
  std::map<int, int> common;
  for (const std::int64_t id : landmark_ids) {
    const auto it = keyframes_of_.find(id);
    if (it == keyframes_of_.end()) continue;
    for (const int keyframe : it->second) ++common[keyframe];
  }
  std::vector<KeyframeCandidate> candidates;
  for (const auto& [keyframe, count] : common) {
    if (count >= min_common) candidates.push_back({keyframe, count});
  }
  return candidates;
}

}  // namespace semantic_topo_loop::core
