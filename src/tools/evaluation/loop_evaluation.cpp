#include "tools/evaluation/loop_evaluation.h"

#include <algorithm>

namespace semantic_topo_loop::core {
namespace {

using JudgedLoops = std::vector<const JudgedLoop*>;

bool is_right(const JudgedLoop& loop, const LoopEvaluationOptions& options) {
  return loop.is_right(options.wide_m, options.wide_deg);
}

/// Figures of loops that are judged and accepted.
ViewpointFigures figures_of(const JudgedLoops& loops, const LoopEvaluationOptions& options) {
  ViewpointFigures figures;
  std::vector<double> errors_m, errors_deg;
  for (const JudgedLoop* loop : loops) {
    errors_m.push_back(loop->error_m);
    errors_deg.push_back(loop->error_deg);
    figures.right_wide.right += is_right(*loop, options) ? 1 : 0;
    figures.right_narrow.right += loop->is_right(options.narrow_m, options.narrow_deg) ? 1 : 0;
  }
  figures.right_wide.total = figures.right_narrow.total = static_cast<int>(loops.size());
  figures.error_m = error_statistics(std::move(errors_m));
  figures.error_deg = error_statistics(std::move(errors_deg));
  return figures;
}

void judge_errors(const JudgedLoops& loops, const LoopEvaluationOptions& options, LoopEvaluation* result) {
  const ViewpointFigures all = figures_of(loops, options);
  result->right_wide = all.right_wide;
  result->right_narrow = all.right_narrow;
  result->error_m = all.error_m;
  result->error_deg = all.error_deg;
}

void judge_viewpoints(const JudgedLoops& loops, const LoopEvaluationOptions& options, LoopEvaluation* result) {
  constexpr double kBinDeg = 180.0 / kViewpointBins;
  std::array<JudgedLoops, kViewpointBins> bins;
  for (const JudgedLoop* loop : loops) {
    bins[std::min<std::size_t>(static_cast<std::size_t>(loop->view_deg / kBinDeg), kViewpointBins - 1)].push_back(loop);
    if (is_right(*loop, options)) {
      result->largest_right_view_deg = std::max(result->largest_right_view_deg, loop->view_deg);
    }
  }
  for (std::size_t i = 0; i < bins.size(); ++i) {
    result->by_viewpoint[i] = figures_of(bins[i], options);
    result->by_viewpoint[i].from_deg = static_cast<double>(i) * kBinDeg;
    result->by_viewpoint[i].to_deg = static_cast<double>(i + 1) * kBinDeg;
  }
}

/// @param loops those over the gap
void judge_query(int query, const JudgedLoops& loops, const TruePoses& truth, const LoopEvaluationOptions& options,
                 LoopEvaluation* result) {
  bool closed = false, at_once = false;
  for (const JudgedLoop* loop : loops) {
    if (!is_right(*loop, options) || !loop->holds_query(truth.stamp_ns(query))) continue;
    closed = true;
    at_once = at_once || loop->query_end <= query + options.at_once_frames;
  }
  result->closed += closed ? 1 : 0;
  result->closed_at_once += at_once ? 1 : 0;
}

std::optional<int> latency_frames(const Revisit& revisit, const JudgedLoops& loops,
                                  const LoopEvaluationOptions& options) {
  std::optional<int> latency;
  for (const JudgedLoop* loop : loops) {
    if (!is_right(*loop, options) || loop->query_end < revisit.first || loop->query_end > revisit.last) continue;
    latency = std::min(latency.value_or(loop->query_end - revisit.first), loop->query_end - revisit.first);
  }
  return latency;
}

/// @param loops those over the gap
void judge_queries(const JudgedLoops& loops, const TruePoses& truth, const LoopEvaluationOptions& options,
                   LoopEvaluation* result) {
  bool is_open = false;
  for (int query = 0; query < truth.size(); query += options.query_stride_frames) {
    if (!truth.is_loopable(query, options.revisit)) {
      is_open = is_open && truth.in_hole(query);
      continue;
    }
    ++result->loopable;
    judge_query(query, loops, truth, options, result);
    if (!is_open) result->revisits.push_back({query, query, std::nullopt});
    result->revisits.back().last = query;
    is_open = true;
  }
  for (Revisit& revisit : result->revisits) revisit.latency_frames = latency_frames(revisit, loops, options);
}

/// @param loops those over the gap
void judge_pairs(const JudgedLoops& loops, const TruePoses& truth, const LoopEvaluationOptions& options,
                 LoopEvaluation* result) {
  for (const JudgedLoop* loop : loops) {
    result->pair_precision.right += truth.is_revisit(loop->query, loop->match, options.revisit) ? 1 : 0;
  }
  result->pair_precision.total = static_cast<int>(loops.size());
  for (int query = 0; query < truth.size(); query += options.query_stride_frames) {
    for (int match = 0; match < query; match += options.query_stride_frames) {
      if (!truth.is_revisit(query, match, options.revisit)) continue;
      ++result->pair_recall.total;
      result->pair_recall.right += std::any_of(loops.begin(), loops.end(), [&](const JudgedLoop* loop) {
        return loop->holds_query(truth.stamp_ns(query)) && loop->holds_match(truth.stamp_ns(match));
      });
    }
  }
}

}  // namespace

LoopEvaluation evaluate_loops(const std::vector<JudgedLoop>& loops, const TruePoses& truth,
                              const LoopEvaluationOptions& options) {
  LoopEvaluation result;
  JudgedLoops accepted, over_gap;
  for (const JudgedLoop& loop : loops) {
    ++result.candidates;
    if (!loop.record.accepted) continue;
    ++result.accepted;
    if (!loop.is_judged) {
      ++result.not_judged;
      continue;
    }
    accepted.push_back(&loop);
    if (truth.over_gap(loop.query, loop.match, options.revisit.min_gap_frames)) over_gap.push_back(&loop);
  }
  judge_errors(accepted, options, &result);
  judge_viewpoints(accepted, options, &result);
  judge_queries(over_gap, truth, options, &result);
  judge_pairs(over_gap, truth, options, &result);
  return result;
}

}  // namespace semantic_topo_loop::core
