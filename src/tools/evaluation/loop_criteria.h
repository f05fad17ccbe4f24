#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/result.h"
#include "tools/evaluation/loop_evaluation.h"

namespace semantic_topo_loop::core {

/// The keyframes of a run and what they show. Table III of the paper counts by keyframe: a frame stands for its
/// keyframe, the last one that is not later.
struct KeyframeViews {
  std::vector<std::int64_t> keyframe_stamps_ns;  ///< of the run, increasing
  /// Objects that an image shows: ids in increasing order, by number of true image. They tell what two keyframes have
  /// in common.
  std::vector<std::vector<std::int64_t>> objects;
};

/// Confirmed objects that were detected in a frame, by its stamp.
using Sightings = std::map<std::int64_t, std::set<std::int64_t>>;

/// From trajectory.txt, associations.csv and objects.csv of a run's directory.
/// @return an error, with file, line, column and value
Result<Sightings> read_sightings(const std::string& directory);

/// A criterion of the literature and what it makes of a run.
struct CriterionCounts {
  const char* name = "";
  RevisitCriterion criterion;
  int keyframes = 0;        ///< of the run
  int reference_pairs = 0;  ///< of keyframes that fulfil the criterion
  int reference_loops = 0;  ///< keyframes with an earlier one in such a pair
  int real_loops = 0;       ///< keyframes with an accepted loop over the gap; the one of the best score counts
  int true_positives = 0;   ///< of these, loops whose keyframes fulfil the criterion
  Ratio right_wide = {};    ///< of the real loops that can be judged by their pose
  int found = 0;            ///< reference loops with any accepted loop, of whatever score, that fulfils the criterion

  Ratio precision() const { return {true_positives, real_loops}; }
  Ratio recall() const { return {true_positives, reference_loops}; }
};

/// The criteria of the paper, of SmSLAM+LCD and of common objects.
std::vector<CriterionCounts> count_by_criterion(const std::vector<JudgedLoop>& loops, const TruePoses& truth,
                                                const KeyframeViews& input);

/// A pair of keyframes that fulfils one of the criteria.
struct ReferencePair {
  int query = -1, match = -1;  ///< images
  int common_objects = 0;
  std::vector<bool> fulfils;  ///< one for each criterion
};
std::vector<ReferencePair> reference_pairs(const TruePoses& truth, const KeyframeViews& input);

/// What accepting every recorded candidate from a score on would give, whatever the detector's other tests said.
struct LoopCurvePoint {
  double min_score = 0.0;
  Ratio precision, recall;  ///< as in CriterionCounts, by the paper's criterion
  Ratio right_wide;         ///< of candidates that are judged and have a pose
  Ratio closed;             ///< loopable queries, as in LoopEvaluation
};
/// @return a point for each distinct score, from the highest down
std::vector<LoopCurvePoint> loop_curve(const std::vector<JudgedLoop>& loops, const TruePoses& truth,
                                       const KeyframeViews& input);

/// CSV files of single loops and pairs, and of the curve, for plots.
std::string judged_loops_csv(const std::vector<JudgedLoop>& loops, const TruePoses& truth);
std::string reference_pairs_csv(const std::vector<ReferencePair>& pairs, const TruePoses& truth);
std::string loop_curve_csv(const std::vector<LoopCurvePoint>& points);

}  // namespace semantic_topo_loop::core
