#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "semantic_topo_loop/frontend/rgbd_frontend.h"
#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/landmark.h"
#include "semantic_topo_loop/types/loop_closure.h"
#include "semantic_topo_loop/types/map_correction.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

struct FrameResult;

/// How a run found its place in the map of earlier sessions that it goes on with.
struct JoinedMap {
  double after_s = 0.0;  ///< from its first keyframe to that of the first loop into the map
  int loops = 0;         ///< into the map, of those that are kept
};

/// Collects what the stages publish and writes a run's files (docs/files.md). The offline program and the recorder
/// nodelet feed it the same objects, so both write the same bytes. Every call is keyed by frame_id; the order between
/// stages does not matter, the order within one stage does, and what comes ten seconds after its frame is at the end
/// of its table. Rows that will not change any more are kept on the disk.
class RunRecorder {
 public:
  virtual ~RunRecorder() = default;

  virtual void record(const Frame& frame) = 0;
  virtual void record(const AssociationFrame& associations) = 0;
  virtual void record(const MapUpdate& update) = 0;
  virtual void record(std::int64_t frame_id, const std::vector<LoopClosure>& loops, double loop_us) = 0;
  /// Where the run is in an earlier run's map, as loop detection has it after a frame.
  virtual void record(const std::optional<Relocalisation>& relocalisation) = 0;
  virtual void record(const MapCorrection& correction) = 0;
  /// What the RGB-D front end made of the images, where there is one.
  virtual void record(const TrackingReport& tracking) = 0;

  /// Writes trajectory_live.txt, trajectory.txt, keyframes.csv, objects.csv, loops.csv, loop_verdicts.csv,
  /// loop_objects.csv, associations.csv, timing.csv, memory.csv and summary.json, and relocalisations.csv if there were
  /// candidates in an earlier run's map, and scales.csv and loop_scales.csv if the scale is free, creating the
  /// directory. All are written before the first takes its place. The run may go on.
  /// @return an error, with the path, if a file cannot be written
  virtual Status write(const std::string& directory) const = 0;
  /// As it was recorded last.
  virtual std::optional<Relocalisation> relocalisation() const = 0;
  /// nullopt without a loop into the map of earlier sessions, or without such a map.
  virtual std::optional<JoinedMap> joined_map() const = 0;
};

/// @return an error if the path is a file that RunRecorder::write replaces in the directory
Status check_survives_run(const std::string& path, const std::string& directory);

/// Records all that a frame came to.
void record(const Frame& frame, const FrameResult& result, RunRecorder* recorder);

/// @param directory is there, with room: rows of a long run are kept in nameless files of it
std::unique_ptr<RunRecorder> make_run_recorder(std::shared_ptr<const ClassTable> classes, std::string directory);

}  // namespace semantic_topo_loop::core
