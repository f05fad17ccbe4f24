#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <set>
#include <utility>
#include <vector>

#include "semantic_topo_loop/types/local_map.h"
#include "semantic_topo_loop/types/loop_closure.h"

namespace semantic_topo_loop::core {

/// What was decided for each pair of keyframes: the accepted loop if there was one, else the latest decision; not where
/// figures are no numbers. Bounded: the earliest queries are forgotten.
class PairRecord {
 public:
  explicit PairRecord(std::size_t capacity) : capacity_(capacity) {}
  /// Takes in candidates of the run itself.
  void add(const std::vector<LoopClosure>& loops);
  /// Takes in what earlier sessions refused.
  void restore(const std::vector<LoopFigures>& refused);
  /// @return null if the pair is not on record
  const LoopFigures* find(std::int64_t query_keyframe_id, std::int64_t match_keyframe_id) const;
  /// Candidates that were refused, in order of query and match.
  std::vector<LoopFigures> refused() const;
  /// Fills what is new in them since the last call, or all there is if the delta is whole.
  void take_delta(SubmapDelta* delta);

 private:
  using Pair = std::pair<std::int64_t, std::int64_t>;  ///< query and match
  void take(const LoopFigures& loop);
  void forget_earliest();

  std::size_t capacity_;
  std::map<Pair, LoopFigures> decisions_;
  std::set<Pair> news_;  ///< of `decisions_`: what take_delta has not told of
};

}  // namespace semantic_topo_loop::core
