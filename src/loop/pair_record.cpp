#include "semantic_topo_loop/loop/pair_record.h"

#include <utility>

namespace semantic_topo_loop::core {

void PairRecord::add(const std::vector<LoopClosure>& loops) {
  for (LoopClosure loop : loops) {
    loop.matches = {};
    loop.covariance.setIdentity();
    auto& of_query = decisions_[loop.query_keyframe_id];
    const auto [it, is_new] = of_query.try_emplace(loop.match_keyframe_id, loop);
    if (is_new) ++size_;
    if (!is_new && (loop.accepted || !it->second.accepted)) it->second = std::move(loop);
  }
  while (size_ > capacity_ && decisions_.size() > 1) {
    size_ -= decisions_.begin()->second.size();
    decisions_.erase(decisions_.begin());
  }
}

const LoopClosure* PairRecord::find(std::int64_t query_keyframe_id, std::int64_t match_keyframe_id) const {
  const auto of_query = decisions_.find(query_keyframe_id);
  if (of_query == decisions_.end()) return nullptr;
  const auto it = of_query->second.find(match_keyframe_id);
  return it == of_query->second.end() ? nullptr : &it->second;
}

}  // namespace semantic_topo_loop::core
