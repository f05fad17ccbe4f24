#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <utility>
#include <vector>

#include "semantic_topo_loop/types/loop_closure.h"

namespace semantic_topo_loop::core {

/// What was decided for each pair of keyframes: the accepted loop if there was one, else the latest decision. Bounded:
/// the earliest queries are forgotten.
class PairRecord {
 public:
  explicit PairRecord(std::size_t capacity) : capacity_(capacity) {}
  /// Takes in candidates of the run itself.
  void add(const std::vector<LoopClosure>& loops);
  /// @return null if the pair is not on record
  const LoopFigures* find(std::int64_t query_keyframe_id, std::int64_t match_keyframe_id) const;

 private:
  std::size_t capacity_;
  std::map<std::pair<std::int64_t, std::int64_t>, LoopFigures> decisions_;  ///< by query and match
};

}  // namespace semantic_topo_loop::core
