#pragma once

#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
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

/// Collects what the stages publish and writes a run's files (docs/files.md). The offline program and the recorder
/// nodelet feed it the same objects, so both write the same bytes. Every call is keyed by frame_id; the order between
/// stages does not matter, the order within one stage does.
class RunRecorder {
 public:
  explicit RunRecorder(std::shared_ptr<const ClassTable> classes) : classes_(std::move(classes)) {}

  void record(const Frame& frame);
  void record(const AssociationFrame& associations);
  void record(const MapUpdate& update);
  void record(std::int64_t frame_id, const std::vector<LoopClosure>& loops, double loop_us);
  void record(const MapCorrection& correction);
  /// What the RGB-D front end made of the images, where there is one.
  void record(const TrackingReport& tracking) { tracking_ = tracking; }

  /// Writes trajectory_live.txt, trajectory.txt, keyframes.csv, objects.csv, loops.csv, loop_verdicts.csv,
  /// associations.csv, timing.csv and summary.json, and relocalisations.csv if there were candidates in an earlier
  /// run's map, and scales.csv and loop_scales.csv if the scale is free, creating the directory. Each file appears
  /// whole or not at all.
  /// @return an error, with the path, if a file cannot be written
  Status write(const std::string& directory) const;
  /// Where the run is in an earlier run's map, by the loops recorded so far.
  std::optional<Relocalisation> relocalisation() const;

 private:
  struct FrameTiming {
    double association_us = 0.0, mapping_us = 0.0, loop_us = 0.0, optimise_us = 0.0;
  };

  struct LoopRow : LoopFigures {
    double log_scale_variance = 0.0;  ///< 0: the scale was not measured
    bool is_in_earlier_map = false;
  };
  using LoopRows = std::map<std::int64_t, std::vector<LoopRow>>;

  /// T_map_odom before the frame's own correction: what a live user had.
  SE3 live_map_from_odom(std::int64_t frame_id) const;
  /// Pose after the last optimisation: hung on the frame's keyframe, or on the last T_map_odom without one.
  SE3 final_pose(const Frame& frame) const;
  std::string trajectory(bool live) const;
  std::string keyframes() const;
  std::string objects() const;
  /// @param in_earlier_map those into an earlier run's map, or the run's own
  std::string loops(bool in_earlier_map) const;
  std::string loop_verdicts() const;
  std::string scales() const;
  std::string loop_scales() const;
  std::string associations() const;
  std::string timing() const;
  std::string summary() const;

  std::shared_ptr<const ClassTable> classes_;
  std::map<std::int64_t, Frame> frames_;                   ///< by frame_id, without the END frame
  std::map<std::int64_t, std::int64_t> keyframe_frames_;   ///< keyframe_id to frame_id
  std::map<std::int64_t, AssociationFrame> associations_;  ///< by frame_id
  std::map<std::int64_t, SE3> T_map_odom_;                 ///< in effect after each frame
  std::map<std::int64_t, Landmark> landmarks_;             ///< latest state of those that still exist
  LoopRows loops_;                                         ///< by frame_id
  /// Accepted ones into an earlier run's map, by frame_id.
  std::map<std::int64_t, std::vector<LoopClosure>> relocalising_;
  bool has_earlier_map_ = false;                 ///< there was a candidate in it
  bool has_loop_scales_ = false;                 ///< a loop states one
  std::map<std::int64_t, Sim3> S_map_keyframe_;  ///< of the last solution, by keyframe_id
  MapCorrection correction_;                     ///< the last that changed something
  std::map<std::int64_t, FrameTiming> timing_;
  std::optional<TrackingReport> tracking_;
  int merges_ = 0;
  int corrections_ = 0;
};

}  // namespace semantic_topo_loop::core
