#include <algorithm>
#include <cmath>
#include <functional>
#include <iterator>
#include <limits>

#include "io/csv.h"
#include "semantic_topo_loop/io/run_files.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "tools/evaluation/loop_evaluation.h"

namespace semantic_topo_loop::core {
namespace {

std::vector<CriterionCounts> make_rows() {
  constexpr double kAny = std::numeric_limits<double>::infinity();
  return {{"paper", {}}, {"original", {1000, 1.0, 53.0, 0}}, {"objects", {500, kAny, kAny, 3}}};
}

/// Keyframes as numbers of true images; those without a true pose are left out.
class Keyframes {
 public:
  Keyframes(const TruePoses& truth, const KeyframeViews& input) : truth_(truth), input_(input) {
    for (const std::int64_t stamp_ns : input.keyframe_stamps_ns) {
      const int image = truth.find(stamp_ns);
      if (image >= 0) images_.push_back(image);
    }
  }

  const std::vector<int>& images() const { return images_; }

  /// The keyframe that an image belongs to, or -1 before the first.
  int of(int image) const {
    const auto after = std::upper_bound(images_.begin(), images_.end(), image);
    return after == images_.begin() ? -1 : *std::prev(after);
  }

  int common_objects(int query, int match) const {
    const auto size = static_cast<int>(input_.objects.size());
    if (query >= size || match >= size) return 0;
    const auto& a = input_.objects[static_cast<std::size_t>(query)];
    const auto& b = input_.objects[static_cast<std::size_t>(match)];
    std::vector<std::int64_t> common;
    std::set_intersection(a.begin(), a.end(), b.begin(), b.end(), std::back_inserter(common));
    return static_cast<int>(common.size());
  }

  bool fulfils(int query, int match, const RevisitCriterion& criterion) const {
    return truth_.is_revisit(query, match, criterion) &&
           (criterion.min_common_objects == 0 || common_objects(query, match) >= criterion.min_common_objects);
  }

 private:
  const TruePoses& truth_;
  const KeyframeViews& input_;
  std::vector<int> images_;
};

/// A candidate over the gap, between keyframes.
struct KeyframeLoop {
  const JudgedLoop* loop = nullptr;
  int query = -1;
  bool is_true_positive = false;
};

std::vector<KeyframeLoop> keyframe_loops(const std::vector<JudgedLoop>& loops, const TruePoses& truth,
                                         const Keyframes& keyframes, const RevisitCriterion& criterion,
                                         bool accepted_only) {
  std::vector<KeyframeLoop> result;
  for (const JudgedLoop& loop : loops) {
    if ((accepted_only && !loop.record.accepted) || loop.query < 0 || loop.match < 0) continue;
    const int query = keyframes.of(loop.query), match = keyframes.of(loop.match);
    if (query < 0 || match < 0 || !truth.over_gap(query, match, criterion.min_gap_frames)) continue;
    if (criterion.needs_poses() && (truth.in_hole(query) || truth.in_hole(match))) continue;
    result.push_back({&loop, query, keyframes.fulfils(query, match, criterion)});
  }
  return result;
}

/// One loop a keyframe, that of the best score.
std::map<int, KeyframeLoop> best_by_keyframe(const std::vector<KeyframeLoop>& loops) {
  std::map<int, KeyframeLoop> best;
  for (const KeyframeLoop& candidate : loops) {
    const auto [known, is_new] = best.emplace(candidate.query, candidate);
    if (!is_new && candidate.loop->record.score > known->second.loop->record.score) known->second = candidate;
  }
  return best;
}

void count_references(const Keyframes& keyframes, CriterionCounts* row) {
  row->keyframes = static_cast<int>(keyframes.images().size());
  for (const int query : keyframes.images()) {
    int pairs = 0;
    for (const int match : keyframes.images()) {
      pairs += match < query && keyframes.fulfils(query, match, row->criterion) ? 1 : 0;
    }
    row->reference_pairs += pairs;
    row->reference_loops += pairs > 0 ? 1 : 0;
  }
}

void count_loops(const std::vector<KeyframeLoop>& loops, CriterionCounts* row) {
  for (const auto& [keyframe, best] : best_by_keyframe(loops)) {
    ++row->real_loops;
    row->true_positives += best.is_true_positive ? 1 : 0;
    row->right_wide.total += best.loop->is_judged ? 1 : 0;
    row->right_wide.right += best.loop->is_right() ? 1 : 0;
  }
  std::set<int> found;
  for (const KeyframeLoop& loop : loops) {
    if (loop.is_true_positive) found.insert(loop.query);
  }
  row->found = static_cast<int>(found.size());
}

/// Values that are right or not, counted from a score on.
class ScoreCounts {
 public:
  void add(double score, bool is_right) { left_.emplace(score, is_right); }
  /// To be asked with falling scores.
  Ratio from(double min_score) {
    for (; !left_.empty() && left_.begin()->first >= min_score; left_.erase(left_.begin())) {
      ++counts_.total;
      counts_.right += left_.begin()->second ? 1 : 0;
    }
    return counts_;
  }

 private:
  std::multimap<double, bool, std::greater<>> left_;  ///< to be counted, the highest first
  Ratio counts_;
};

/// For each loopable query the best score of a right candidate over the gap that holds it.
void count_queries(const std::vector<JudgedLoop>& loops, const TruePoses& truth, int* loopable, ScoreCounts* closed) {
  for (int query = 0; query < truth.size(); query += kLoopLimits.query_stride_frames) {
    if (!truth.is_loopable(query, kLoopLimits.revisit)) continue;
    ++*loopable;
    std::optional<double> best;
    for (const JudgedLoop& loop : loops) {
      if (!loop.is_right() || !loop.holds_query(truth.stamp_ns(query)) ||
          !truth.over_gap(loop.query, loop.match, kLoopLimits.revisit.min_gap_frames)) {
        continue;
      }
      best = std::max(best.value_or(loop.record.score), loop.record.score);
    }
    if (best) closed->add(*best, true);
  }
}

}  // namespace

Result<SightingsByStamp> read_sightings(const std::string& directory) {
  const auto objects = read_objects(directory + "/objects.csv");
  if (!objects) return objects.error();
  const auto frames = read_tum_trajectory(directory + "/trajectory.txt");
  if (!frames) return frames.error();
  const auto keyframes = read_keyframes(directory + "/keyframes.csv");
  if (!keyframes) return keyframes.error();
  const std::int64_t first_frame = first_frame_id(*keyframes);
  std::set<std::int64_t> confirmed;
  for (const MappedObject& object : *objects) {
    if (object.state == "confirmed") confirmed.insert(object.id);
  }
  SightingsByStamp sightings;
  const auto read_row = [&](CsvTable& table) {
    const std::int64_t frame = table.integer("frame_id"), id = table.integer("landmark_id");
    const std::int64_t row = frame >= first_frame ? frame - first_frame : -1;
    const bool is_known = row >= 0 && row < static_cast<std::int64_t>(frames->size());
    if (!is_known) table.reject("frame_id", "is no frame of trajectory.txt");
    if (is_known && confirmed.count(id) > 0) sightings[(*frames)[static_cast<std::size_t>(row)].stamp_ns].insert(id);
    return id;
  };
  const auto rows = read_csv<std::int64_t>(directory + "/associations.csv", read_row);
  if (!rows) return rows.error();
  return sightings;
}

std::vector<CriterionCounts> count_by_criterion(const std::vector<JudgedLoop>& loops, const TruePoses& truth,
                                                const KeyframeViews& input) {
  const Keyframes keyframes(truth, input);
  std::vector<CriterionCounts> rows = make_rows();
  for (CriterionCounts& row : rows) {
    count_references(keyframes, &row);
    count_loops(keyframe_loops(loops, truth, keyframes, row.criterion, true), &row);
  }
  return rows;
}

std::vector<ReferencePair> reference_pairs(const TruePoses& truth, const KeyframeViews& input) {
  const Keyframes keyframes(truth, input);
  const std::vector<CriterionCounts> rows = make_rows();
  std::vector<ReferencePair> pairs;
  for (const int query : keyframes.images()) {
    for (const int match : keyframes.images()) {
      if (match >= query) break;
      ReferencePair pair{query, match, keyframes.common_objects(query, match), {}};
      for (const CriterionCounts& row : rows) pair.fulfils.push_back(keyframes.fulfils(query, match, row.criterion));
      if (std::find(pair.fulfils.begin(), pair.fulfils.end(), true) != pair.fulfils.end()) pairs.push_back(pair);
    }
  }
  return pairs;
}

std::vector<LoopCurvePoint> loop_curve(const std::vector<JudgedLoop>& loops, const TruePoses& truth,
                                       const KeyframeViews& input) {
  const Keyframes keyframes(truth, input);
  ScoreCounts revisits, right, closed;
  const auto candidates = keyframe_loops(loops, truth, keyframes, kLoopLimits.revisit, false);
  for (const auto& [keyframe, best] : best_by_keyframe(candidates)) {
    revisits.add(best.loop->record.score, best.is_true_positive);
  }
  std::set<double, std::greater<>> scores;
  for (const JudgedLoop& loop : loops) {
    scores.insert(loop.record.score);
    if (loop.is_judged && std::isfinite(loop.error_m)) right.add(loop.record.score, loop.is_right());
  }
  CriterionCounts paper{"paper", kLoopLimits.revisit};
  count_references(keyframes, &paper);
  int loopable = 0;
  count_queries(loops, truth, &loopable, &closed);
  std::vector<LoopCurvePoint> points;
  for (const double score : scores) {
    const Ratio precision = revisits.from(score);
    points.push_back({score,
                      precision,
                      {precision.right, paper.reference_loops},
                      right.from(score),
                      {closed.from(score).right, loopable}});
  }
  return points;
}

std::string judged_loops_csv(const std::vector<JudgedLoop>& loops, const TruePoses& truth) {
  std::string text =
      "query_image,match_image,accepted,reason,score,judged,error_m,error_deg,distance_m,axes_deg,view_deg,gap_"
      "frames\n";
  for (const JudgedLoop& loop : loops) {
    const bool has_images = loop.query >= 0 && loop.match >= 0;
    const std::int64_t gap = has_images ? truth.stamp_ns(loop.query) - truth.stamp_ns(loop.match) : 0;
    text += csv_row(loop.query, loop.match, loop.record.accepted, loop.record.reason_text, loop.record.score,
                    loop.is_judged, loop.error_m, loop.error_deg, loop.distance_m, loop.axes_deg, loop.view_deg,
                    truth.period_ns() > 0 ? gap / truth.period_ns() : 0);
  }
  return text;
}

std::string reference_pairs_csv(const std::vector<ReferencePair>& pairs, const TruePoses& truth) {
  std::string text = "query_image,match_image,distance_m,axes_deg,common_objects";
  for (const CriterionCounts& row : make_rows()) text += std::string(",") + row.name;
  text += '\n';
  constexpr int kDecimals = 3;
  for (const ReferencePair& pair : pairs) {
    std::string fulfils;
    for (const bool fulfilled : pair.fulfils) fulfils += (fulfils.empty() ? "" : ",") + csv_field(fulfilled);
    text +=
        csv_row(pair.query, pair.match, format_fixed(truth.distance_m(pair.query, pair.match), kDecimals),
                format_fixed(truth.axes_angle_deg(pair.query, pair.match), kDecimals), pair.common_objects, fulfils);
  }
  return text;
}

std::string loop_curve_csv(const std::vector<LoopCurvePoint>& points) {
  std::string text =
      "min_score,true_positives,real_loops,reference_loops,right_wide,judged,closed_queries,loopable_queries\n";
  for (const LoopCurvePoint& p : points) {
    text += csv_row(p.min_score, p.precision.right, p.precision.total, p.recall.total, p.right_wide.right,
                    p.right_wide.total, p.closed.right, p.closed.total);
  }
  return text;
}

}  // namespace semantic_topo_loop::core
