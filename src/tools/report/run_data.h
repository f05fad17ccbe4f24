#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "semantic_topo_loop/geometry/alignment.h"
#include "semantic_topo_loop/io/run_files.h"
#include "semantic_topo_loop/types/result.h"
#include "semantic_topo_loop/types/stamp.h"
#include "tools/evaluation/object_evaluation.h"
#include "tools/evaluation/trajectory_evaluation.h"

namespace semantic_topo_loop::core {

/// What a report is made from. All but `run` may be empty.
struct ReportInputs {
  std::string run;          ///< directory of a run
  std::string odometry;     ///< the trajectory that the run was given
  std::string truth;        ///< ground truth, in whose world everything is shown then, its z axis up
  std::string reference;    ///< reference objects in that world; only with `truth`
  bool with_scale = false;  ///< align by a similarity (monocular odometry)
  std::optional<int> loop;  ///< number of the accepted loop that is shown first, from 1; else the one of most objects
};

constexpr std::array<const char*, 4> kStages = {"association", "mapping", "loop", "optimise"};

struct FrameTiming {
  std::int64_t frame_id = -1;
  std::array<double, kStages.size()> stages_us{};
};

struct MemoryRecord {
  std::int64_t frame_id = -1;
  double resident_mb = 0.0, peak_mb = 0.0;
};

/// A trajectory as it is shown: against the ground truth, if there is one.
struct ShownTrajectory {
  std::string name;
  StampedPoses poses;
  Sim3 S_world_map;                                ///< identity without ground truth
  std::optional<TrajectoryEvaluation> evaluation;  ///< with ground truth
};

/// A loop of loops.csv.
struct ShownLoop {
  LoopRecord record;
  int number = 0;                              ///< of the accepted ones, from 1; 0 for the others
  bool is_kept = false;                        ///< an accepted one that the pose graph believes
  std::string verdict;                         ///< of the pose graph on an accepted one
  std::vector<LoopObjectRecord> query, match;  ///< objects of the two submaps
};

/// A row of loop_verdicts.csv.
struct VerdictRecord {
  std::int64_t query_frame = -1, match_frame = -1;
  bool is_extra = false, is_kept = false;
  std::string verdict;
};

/// The files of a run, read and put together.
struct RunData {
  std::string name;                           ///< of the directory
  std::vector<ShownTrajectory> trajectories;  ///< odometry if it was given, live, optimised
  StampedPoses truth;
  std::size_t keyframes = 0;
  std::vector<MappedObject> objects;
  std::vector<ReferenceObject> references;
  std::optional<ObjectEvaluation> object_evaluation;  ///< with references
  std::vector<ShownLoop> loops;
  std::vector<VerdictRecord> extra_loops;  ///< from outside
  std::vector<FrameTiming> timing;         ///< a row a pose of the optimised trajectory
  std::vector<MemoryRecord> memory;

  const ShownTrajectory& optimised() const { return trajectories.back(); }
  std::int64_t begin_ns() const { return optimised().poses.front().stamp_ns; }
  /// Seconds since the first frame.
  double seconds(std::int64_t stamp_ns) const { return 1e-9 * static_cast<double>(stamp_ns - begin_ns()); }
  /// The optimised pose of a frame, nullptr for one of another run.
  const StampedPose* pose_of(std::int64_t frame_id) const;
  /// Whether a loop leads into an earlier session of the map.
  bool is_into_map(const LoopRecord& loop) const { return loop.match_frame < timing.front().frame_id; }
  /// Since the first frame: "12.3 s", or "earlier session".
  std::string match_time(const LoopRecord& loop) const;
};

/// @return an error that names the file, and the line, if one is missing or damaged, or what does not fit together
Result<RunData> read_run(const ReportInputs& inputs);

}  // namespace semantic_topo_loop::core
