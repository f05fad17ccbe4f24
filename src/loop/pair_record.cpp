#include "loop/pair_record.h"

#include <algorithm>

namespace semantic_topo_loop::core {
namespace {

/// Iterator to the loop with a match, or the end: a query has few.
template <class Loops>
auto find_match(Loops& loops, std::int64_t match_keyframe_id) {
  return std::find_if(loops.begin(), loops.end(), [match_keyframe_id](const LoopFigures& loop) {
    return loop.match_keyframe_id == match_keyframe_id;
  });
}

}  // namespace

void PairRecord::add(const std::vector<LoopClosure>& loops) {
  for (const LoopFigures& loop : loops) {
    std::vector<LoopFigures>& of_query = decisions_[loop.query_keyframe_id];
    const auto known = find_match(of_query, loop.match_keyframe_id);
    if (known == of_query.end()) {
      of_query.push_back(loop);
      ++size_;
    } else if (loop.accepted || !known->accepted) {
      *known = loop;
    }
  }
  while (size_ > capacity_ && decisions_.size() > 1) {
    size_ -= decisions_.begin()->second.size();
    decisions_.erase(decisions_.begin());
  }
}

const LoopFigures* PairRecord::find(std::int64_t query_keyframe_id, std::int64_t match_keyframe_id) const {
  const auto of_query = decisions_.find(query_keyframe_id);
  if (of_query == decisions_.end()) return nullptr;
  const auto known = find_match(of_query->second, match_keyframe_id);
  return known == of_query->second.end() ? nullptr : &*known;
}

}  // namespace semantic_topo_loop::core
