#include <array>
#include <sstream>

#include "loop/pair_record.h"
#include "loop/paper/paper_detector.h"
#include "semantic_topo_loop/loop/loop_detector.h"
#include "semantic_topo_loop/loop/loop_options.h"

namespace semantic_topo_loop::core {
namespace {

class Sentence {
 public:
  /// Left out if the figure was not computed.
  Sentence& add(const char* name, double value, const char* relation, double threshold) {
    if (value >= 0.0) text_ << ", " << name << ' ' << value << " (" << relation << ' ' << threshold << ')';
    return *this;
  }
  std::ostringstream& stream() { return text_; }

 private:
  std::ostringstream text_;
};

}  // namespace

const char* to_string(PairStatus status) {
  constexpr std::array<const char*, 8> kNames = {"verified",   "unknown_keyframe", "wrong_order",  "no_submap",
                                                 "too_recent", "not_proposed",     "no_alignment", "not_attempted"};
  const auto i = static_cast<std::size_t>(status);
  return i < kNames.size() ? kNames[i] : "unknown";
}

std::string describe(const LoopFigures& loop, const LoopOptions& options) {
  Sentence sentence;
  sentence.stream().precision(3);
  sentence.stream() << (loop.accepted ? "accepted" : "rejected: ") << (loop.accepted ? "" : to_string(loop.reason));
  if (loop.reason == LoopReason::kFoundBySource) {
    sentence.stream() << ": not by objects, but by " << loop.inliers << " points";
    return sentence.stream().str();
  }
  const bool is_paper = options.mode == "paper";
  if (is_paper) {
    const bool printed = options.score == "printed";
    sentence.add("common landmarks", loop.inliers, ">=", options.paper_min_common)
        .add("score", loop.score, ">=", printed ? options.paper_printed_min_score : options.paper_corrected_min_score);
  } else {
    const bool is_confirmed = loop.accepted && loop.inliers < options.min_inliers;
    const int min_inliers = is_confirmed ? options.min_confirmed_inliers : options.min_inliers;
    sentence.add("aligned objects", loop.inliers, ">=", min_inliers)
        .add("classes", loop.labels, ">=", options.min_labels)
        .add("score", loop.score, ">=", options.ambiguity_ratio * loop.second_score);
  }
  const double sigma_factor = is_paper ? kPaperVagueness : 1.0;
  return sentence.add("spread m", loop.spread_m, ">=", options.min_spread_m)
      .add("rms m", loop.rms_m, "<=", options.max_rms_m)
      .add("tilt deg", loop.tilt_deg, "<=", options.max_tilt_deg)
      .add("reprojection ratio", loop.reprojection_ratio, ">", options.min_reprojection_ratio)
      .add("reprojected objects", loop.reprojected_objects, ">=", options.min_reprojected_objects)
      .add("explained share", loop.explained_share, ">", options.min_explained_share)
      .add("box residual", loop.refine_residual, "<=", options.refine_max_residual)
      .add("refinement m", loop.refine_shift_m, "<=", options.refine_max_shift_m)
      .add("refinement deg", loop.refine_shift_deg, "<=", options.refine_max_shift_deg)
      .add("sigma m", loop.sigma_m, "<=", sigma_factor * options.max_sigma_m)
      .add("sigma deg", loop.sigma_deg, "<=", sigma_factor * options.max_sigma_deg)
      .stream()
      .str();
}

void PairRecord::add(const std::vector<LoopClosure>& loops) {
  for (const LoopFigures& loop : loops) take(loop);
  forget_earliest();
}

void PairRecord::restore(const std::vector<LoopFigures>& refused) {
  for (const LoopFigures& loop : refused) take(loop);
  forget_earliest();
}

void PairRecord::take(const LoopFigures& loop) {
  if (!is_finite(loop)) return;
  const Pair pair(loop.query_keyframe_id, loop.match_keyframe_id);
  const auto [known, is_new] = decisions_.emplace(pair, loop);
  if (!is_new && known->second.accepted && !loop.accepted) return;
  if (!loop.accepted || !is_new) news_.insert(pair);
  known->second = loop;
}

/// With all its candidates, so that what is left is told by a query.
void PairRecord::forget_earliest() {
  while (decisions_.size() > capacity_) {
    const std::int64_t query = decisions_.begin()->first.first;
    while (!decisions_.empty() && decisions_.begin()->first.first == query) {
      news_.erase(decisions_.begin()->first);
      decisions_.erase(decisions_.begin());
    }
  }
}

std::vector<LoopFigures> PairRecord::refused() const {
  std::vector<LoopFigures> refused;
  for (const auto& [pair, loop] : decisions_) {
    if (!loop.accepted) refused.push_back(loop);
  }
  return refused;
}

void PairRecord::take_delta(SubmapDelta* delta) {
  if (delta->is_whole) {
    delta->decided = refused();
  } else {
    for (const Pair& pair : news_) delta->decided.push_back(decisions_.at(pair));
  }
  news_.clear();
  if (!decisions_.empty()) delta->first_query = decisions_.begin()->first.first;
}

const LoopFigures* PairRecord::find(std::int64_t query_keyframe_id, std::int64_t match_keyframe_id) const {
  const auto known = decisions_.find({query_keyframe_id, match_keyframe_id});
  return known == decisions_.end() ? nullptr : &known->second;
}

}  // namespace semantic_topo_loop::core
