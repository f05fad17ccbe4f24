#pragma once

#include <optional>
#include <string>
#include <vector>

#include "semantic_topo_loop/evaluation/statistics.h"
#include "semantic_topo_loop/geometry/stamped_pose.h"

namespace semantic_topo_loop::core {

/// A row of loops.csv.
struct LoopRecord {
  std::int64_t query_frame = -1, match_frame = -1;
  std::int64_t query_stamp_ns = 0, match_stamp_ns = 0;
  std::int64_t query_begin = -1, query_end = -1, match_begin = -1, match_end = -1;  ///< frame_id
  bool accepted = false;
  std::string reason;
  SE3 T_match_query;
};

struct LoopEvaluationOptions {
  double wide_m = 0.35, wide_deg = 10.0;     ///< a loop within both is right
  double narrow_m = 0.20, narrow_deg = 5.0;  ///< the same, stricter
  int min_gap_frames = 1000;                 ///< periods between the two frames of a revisit
  double max_distance_m = 3.0;               ///< between the cameras of a revisit
  double max_view_angle_deg = 80.0;          ///< between their optical axes
  int query_stride_frames = 15;              ///< every so many frames is a query
  int at_once_frames = 15;                   ///< evidence that ends this soon closes the query at once
  double max_mocap_gap_s = 0.1;              ///< a wider gap between two mocap poses is a hole
};

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
};

/// Judges a run's loops by true camera poses.
/// @param frames poses of the run's trajectory.txt: row k has frame_id k
/// @param truth a pose for every image, from the mocap
/// @param mocap the mocap's own poses, to find its holes; empty: there are none
/// @return nullopt, with the cause in `error`, if the run and the truth have no frame in common or a loop names a frame
/// that the run does not have
std::optional<LoopEvaluation> evaluate_loops(const std::vector<LoopRecord>& loops, const StampedPoses& frames,
                                             const StampedPoses& truth, const StampedPoses& mocap,
                                             const LoopEvaluationOptions& options, std::string* error);

}  // namespace semantic_topo_loop::core
