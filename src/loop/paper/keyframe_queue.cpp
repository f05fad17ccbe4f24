#include "loop/paper/keyframe_queue.h"

#include <set>

namespace semantic_topo_loop::core {

void ObjectIndex::insert(int keyframe, const std::vector<std::int64_t>& landmark_ids) {
  for (const std::int64_t id : landmark_ids) {
    std::vector<int>& keyframes = keyframes_of_[id];
    if (keyframes.empty() || keyframes.back() != keyframe) keyframes.push_back(keyframe);
  }
}

std::vector<KeyframeCandidate> ObjectIndex::query(const std::vector<std::int64_t>& landmark_ids,
                                                  const LandmarkRedirects& redirects, int min_common) const {
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
  std::vector<KeyframeCandidate> candidates;
  for (const auto& [keyframe, count] : common) {
    if (count >= min_common) candidates.push_back({keyframe, count});
  }
  return candidates;
}

}  // namespace semantic_topo_loop::core
