#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "semantic_topo_loop/loop/loop_options.h"
#include "semantic_topo_loop/types/loop_closure.h"

namespace semantic_topo_loop::core {

/// What became of a pair of keyframes.
enum class PairStatus : std::uint8_t {
  kVerified = 0,         ///< it reached verification in the run
  kUnknownKeyframe = 1,  ///< the run has no such keyframe
  kWrongOrder = 2,       ///< the query is not the later one
  kNoSubmap = 3,         ///< no submap was kept about one of them: a break, too few objects or too little time
  kTooRecent = 4,        ///< closer in time than `min_gap_s`
  kNotProposed = 5,      ///< the index preferred other submaps
  kNoAlignment = 6,      ///< the submaps share no group of objects whose distances agree
  kNotAttempted = 7,     ///< the submaps can be compared, but were not: loop closing was off, or another mode
};

const char* to_string(PairStatus status);

/// Answer to the question why two keyframes were closed, or were not.
struct LoopExplanation {
  PairStatus status = PairStatus::kUnknownKeyframe;
  std::string text;  ///< in words, with each figure beside its threshold
  /// kVerified: what the run decided, without covariances and matches; otherwise what a comparison for this answer
  /// gives, if there was one. Its keyframes are the anchors of the submaps that were compared.
  std::optional<LoopClosure> closure;
};

/// Decision and figures of a candidate of graph mode, each with the threshold that applies.
std::string describe(const LoopFigures& loop, const LoopOptions& options);

}  // namespace semantic_topo_loop::core
