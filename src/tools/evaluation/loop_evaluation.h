#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "tools/evaluation/loop_judge.h"

namespace semantic_topo_loop::core {

struct LoopEvaluationOptions {
  double wide_m = 0.35, wide_deg = 10.0;     ///< a loop within both is right
  double narrow_m = 0.20, narrow_deg = 5.0;  ///< the same, stricter
  RevisitCriterion revisit;                  ///< the paper's; tells loopable queries
  int query_stride_frames = 15;              ///< every so many frames is a query
  int at_once_frames = 15;                   ///< evidence that ends this soon closes the query at once
};

/// The accepted loops of one range of viewpoint differences (JudgedLoop::view_deg).
struct ViewpointFigures {
  double from_deg = 0.0, to_deg = 0.0;
  Ratio right_wide, right_narrow;
  ErrorStatistics error_m, error_deg;
};

/// Consecutive loopable queries; queries in holes of the mocap do not end a revisit.
struct Revisit {
  int first = -1, last = -1;          ///< images of the first and last loopable query
  std::optional<int> latency_frames;  ///< from the first to the end of the evidence of the first right loop over the
                                      ///< gap that was accepted from then to the last; nullopt: there was none
};

constexpr int kViewpointBins = 6;

struct LoopEvaluation {
  int candidates = 0, accepted = 0;
  int not_judged = 0;                  ///< accepted, but an end lies in a mocap hole or has no true pose
  Ratio right_wide, right_narrow;      ///< of the accepted ones that were judged
  ErrorStatistics error_m, error_deg;  ///< of the accepted ones that were judged
  int loopable = 0;                    ///< queries that revisit a place
  int closed = 0;                      ///< by a right loop over the gap whose evidence contains them
  int closed_at_once = 0;              ///< and whose evidence ends soon after them
  Ratio pair_precision;                ///< the paper's: accepted loops over the gap that see the same place
  Ratio pair_recall;                   ///< the paper's: revisiting pairs of queries that lie in such a loop's evidence
  std::array<ViewpointFigures, kViewpointBins> by_viewpoint;  ///< of the accepted ones that were judged
  double largest_right_view_deg = 0.0;                        ///< viewpoint difference of a right loop
  std::vector<Revisit> revisits;
};

/// Judges a run's loops by true camera poses.
LoopEvaluation evaluate_loops(const std::vector<JudgedLoop>& loops, const TruePoses& truth,
                              const LoopEvaluationOptions& options);

}  // namespace semantic_topo_loop::core
