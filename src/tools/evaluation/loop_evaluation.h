#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "semantic_topo_loop/io/run_files.h"
#include "semantic_topo_loop/types/result.h"
#include "semantic_topo_loop/types/stamp.h"
#include "tools/evaluation/trajectory_evaluation.h"

namespace semantic_topo_loop::core {

/// When two frames show the same place. Limits that are not asked for are infinite or 0.
struct RevisitCriterion {
  int min_gap_frames = 1000;         ///< periods between the two frames
  double max_distance_m = 3.0;       ///< between the cameras
  double max_view_angle_deg = 80.0;  ///< between their optical axes
  int min_common_objects = 0;        ///< objects that both see

  bool needs_poses() const { return max_distance_m < std::numeric_limits<double>::infinity(); }
};

/// By which loops are judged.
struct LoopLimits {
  double wide_m = 0.35, wide_deg = 10.0;     ///< a loop within both is right
  double narrow_m = 0.20, narrow_deg = 5.0;  ///< the same, stricter
  RevisitCriterion revisit;                  ///< the paper's; tells loopable queries
  int query_stride_frames = 15;              ///< every so many frames is a query
  int at_once_frames = 15;                   ///< evidence that ends this soon closes the query at once
};
inline constexpr LoopLimits kLoopLimits{};

/// The true poses, by number of image.
class TruePoses {
 public:
  /// @param mocap the motion capture's own poses; a gap between two that is wider than `max_mocap_gap_s` is a hole.
  /// Empty: there are none
  TruePoses(StampedPoses poses, const StampedPoses& mocap, double max_mocap_gap_s);

  int size() const { return static_cast<int>(poses_.size()); }
  std::int64_t stamp_ns(int i) const { return poses_[static_cast<std::size_t>(i)].stamp_ns; }
  const SE3& pose(int i) const { return poses_[static_cast<std::size_t>(i)].T_world_camera; }
  bool in_hole(int i) const { return in_hole_[static_cast<std::size_t>(i)]; }
  /// The usual time between two images.
  std::int64_t period_ns() const { return period_ns_; }

  /// Number of the image of a stamp, or -1.
  int find(std::int64_t stamp_ns) const;
  /// Number of the image nearest to a stamp; there must be one.
  int nearest(std::int64_t stamp_ns) const;

  double distance_m(int a, int b) const { return (pose(a).t - pose(b).t).norm(); }
  /// Angle between the optical axes.
  double axes_angle_deg(int a, int b) const;
  bool over_gap(int query, int match, int min_gap_frames) const {
    return stamp_ns(query) - stamp_ns(match) > min_gap_frames * period_ns_;
  }
  /// True if the query sees, much later, a place that the match saw; common objects are not looked at.
  bool is_revisit(int query, int match, const RevisitCriterion& criterion) const;
  /// True if the image revisits any earlier one.
  bool is_loopable(int query, const RevisitCriterion& criterion) const;

 private:
  StampedPoses poses_;
  std::int64_t period_ns_ = 0;
  std::vector<bool> in_hole_;
};

/// A candidate beside the truth. Without a true pose at both ends, or with an end in a hole of the mocap, `is_judged`
/// is false and the figures below it say nothing.
struct JudgedLoop {
  LoopRecord record;
  int query = -1, match = -1;  ///< numbers of the true images, -1 without one
  int query_end = -1;          ///< the image nearest to the end of the query's evidence
  std::int64_t query_begin_ns = 0, query_end_ns = 0, match_begin_ns = 0, match_end_ns = 0;
  bool is_judged = false;
  double error_m = 0.0, error_deg = 0.0;  ///< infinite for a candidate without a pose
  double distance_m = 0.0;                ///< between the two cameras
  double axes_deg = 0.0;                  ///< between their optical axes
  double view_deg = 0.0;                  ///< viewpoint difference: angle of the rotation between them

  bool holds_query(std::int64_t ns) const { return query_begin_ns <= ns && ns <= query_end_ns; }
  bool holds_match(std::int64_t ns) const { return match_begin_ns <= ns && ns <= match_end_ns; }
  bool is_right(double max_m = kLoopLimits.wide_m, double max_deg = kLoopLimits.wide_deg) const {
    return is_judged && error_m <= max_m && error_deg <= max_deg;
  }
};

/// The frame_id of a run's first frame, which is a keyframe; not 0 where the run goes on with a map.
std::int64_t first_frame_id(const std::vector<KeyframePose>& keyframes);

/// Puts every candidate within the run beside the truth, in the order of `loops`. Those into earlier sessions of its
/// map are left out: where their frames are this run does not tell.
/// @param frames poses of the run's trajectory.txt: row k has frame_id `first_frame` + k
/// @return an error, with the cause, if the run and the truth have no frame in common or a loop names a frame
/// that the run does not have
Result<std::vector<JudgedLoop>> judge_loops(const std::vector<LoopRecord>& loops, const StampedPoses& frames,
                                            const TruePoses& truth, std::int64_t first_frame = 0);

/// Of accepted loops that were judged.
struct LoopErrors {
  Ratio right_wide, right_narrow;
  ErrorStatistics error_m, error_deg;
};

/// Those of one range of viewpoint differences (JudgedLoop::view_deg).
struct ViewpointFigures : LoopErrors {
  double from_deg = 0.0, to_deg = 0.0;
};

/// Consecutive loopable queries; queries in holes of the mocap do not end a revisit.
struct Revisit {
  int first = -1, last = -1;          ///< images of the first and last loopable query
  std::optional<int> latency_frames;  ///< from the first to the end of the evidence of the first right loop over the
                                      ///< gap that was accepted from then to the last; nullopt: there was none
};

constexpr int kViewpointBins = 6;

struct LoopEvaluation : LoopErrors {
  int candidates = 0, accepted = 0;
  int not_judged = 0;      ///< accepted, but an end lies in a mocap hole or has no true pose
  int loopable = 0;        ///< queries that revisit a place
  int closed = 0;          ///< by a right loop over the gap whose evidence contains them
  int closed_at_once = 0;  ///< and whose evidence ends soon after them
  Ratio pair_precision;    ///< the paper's: accepted loops over the gap that see the same place
  Ratio pair_recall;       ///< the paper's: revisiting pairs of queries that lie in such a loop's evidence
  std::array<ViewpointFigures, kViewpointBins> by_viewpoint;  ///< of the accepted ones that were judged
  double largest_right_view_deg = 0.0;                        ///< viewpoint difference of a right loop
  std::vector<Revisit> revisits;
};

/// Judges a run's loops by true camera poses.
LoopEvaluation evaluate_loops(const std::vector<JudgedLoop>& loops, const TruePoses& truth);

// --- by the criteria of the literature (loop_criteria.cpp) ---------------------------------------------------------

/// The keyframes of a run and what they show. Table III of the paper counts by keyframe: a frame stands for its
/// keyframe, the last one that is not later.
struct KeyframeViews {
  std::vector<std::int64_t> keyframe_stamps_ns;  ///< of the run, increasing
  /// Objects that an image shows: ids in increasing order, by number of true image. They tell what two keyframes have
  /// in common.
  std::vector<std::vector<std::int64_t>> objects;
};

/// Confirmed objects that were detected in a frame, by its stamp.
using SightingsByStamp = std::map<std::int64_t, std::set<std::int64_t>>;

/// From trajectory.txt, keyframes.csv, associations.csv and objects.csv of a run's directory.
/// @return an error, with file, line, column and value
Result<SightingsByStamp> read_sightings(const std::string& directory);

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
