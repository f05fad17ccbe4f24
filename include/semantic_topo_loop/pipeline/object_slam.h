#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "semantic_topo_loop/association/object_associator.h"
#include "semantic_topo_loop/loop/loop_detector.h"
#include "semantic_topo_loop/map/quadric_mapper.h"
#include "semantic_topo_loop/pipeline/options.h"
#include "semantic_topo_loop/pose_graph/pose_graph.h"
#include "semantic_topo_loop/types/local_map.h"

namespace semantic_topo_loop::core {

/// What the stages made of one frame, in the order they ran.
struct FrameResult {
  AssociationFrame associations;
  MapUpdate observation;  ///< after the associations were integrated
  std::vector<LoopClosure> loops;
  double loop_us = 0.0;
  MapCorrection correction;
  MapUpdate completion;  ///< after the correction was applied
};

/// The whole chain on one thread: association, mapping, loop detection, pose graph. The nodelets call the same stages
/// in the same order, so that lockstep playback gives the same bytes.
class ObjectSlam {
 public:
  ObjectSlam(const Options& options, std::shared_ptr<const ClassTable> classes);

  /// @param detections null: the detector did not look at this frame's image
  /// @param extra_loops handed to the pose graph beside those that are found
  FrameResult process(const Frame& frame, const std::vector<Detection>* detections,
                      const std::vector<LoopClosure>& extra_loops = {});
  /// Looks for the run's place in the submaps of an earlier run (io/submap_file.h), too. Call it before the first
  /// frame.
  void set_earlier_map(std::vector<LocalMap> submaps) { loop_detector_.set_earlier_map(std::move(submaps)); }
  /// The run's own submaps, in its map.
  std::vector<LocalMap> submaps_in_map() const;
  const QuadricMapper& mapper() const { return mapper_; }
  const PoseGraph& pose_graph() const { return pose_graph_; }

 private:
  ObjectAssociator associator_;
  QuadricMapper mapper_;
  LoopDetector loop_detector_;
  PoseGraph pose_graph_;
};

/// Takes submaps from the odometry's world and unit of length to the map's, so that a later run can be placed in it.
/// @param keyframes of the last solution, ascending; submaps of later keyframes move with T_map_odom
void move_to_map(const std::vector<KeyframePose>& keyframes, const SE3& T_map_odom, std::vector<LocalMap>* submaps);

}  // namespace semantic_topo_loop::core
