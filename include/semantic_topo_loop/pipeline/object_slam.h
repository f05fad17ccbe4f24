#pragma once

#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "semantic_topo_loop/association/object_associator.h"
#include "semantic_topo_loop/loop/loop_detector.h"
#include "semantic_topo_loop/map/quadric_mapper.h"
#include "semantic_topo_loop/pipeline/options.h"
#include "semantic_topo_loop/pose_graph/pose_graph.h"
#include "semantic_topo_loop/types/local_map.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

struct MapDelta;
struct MapState;
struct MergedMaps;

/// What the stages made of one frame, in the order they ran.
struct FrameResult {
  AssociationFrame associations;
  MapUpdate observation;  ///< after the associations were integrated
  std::vector<LoopClosure> loops;
  double loop_us = 0.0;
  std::optional<Relocalisation> relocalisation;  ///< see LoopDetector
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
  /// Goes on with earlier sessions' map (io/map_file.h): loops into it are loops of one graph, and until one is found
  /// this session stands beside it. Call it before the first frame, whose ids go on from the map's.
  /// @return the map's objects, for who follows the map
  MapUpdate restore(const MapState& map);
  /// The map so far.
  std::shared_ptr<const MapState> map() const;
  /// What is new in it since the last call, for io/map_database.h.
  std::shared_ptr<const MapDelta> take_delta();
  /// Only looks for the run's place in the submaps of an earlier run, which stays as it is. Call it before the first
  /// frame.
  void set_earlier_map(std::vector<LocalMap> submaps) { loop_detector_.set_earlier_map(std::move(submaps)); }
  const QuadricMapper& mapper() const { return mapper_; }
  const LoopDetector& loop_detector() const { return loop_detector_; }
  const PoseGraph& pose_graph() const { return pose_graph_; }

 private:
  friend MergedMaps merge_maps(const MapState& a, MapState b, const Options& options,
                               std::shared_ptr<const ClassTable> classes);
  void tell(const MapUpdate& update);

  ObjectAssociator associator_;
  QuadricMapper mapper_;
  LoopDetector loop_detector_;
  PoseGraph pose_graph_;
};

/// Has a pose graph go on with a map's, and with its objects' boxes.
void restore_graph(const MapState& map, PoseGraph* graph);
/// Has a mapper go on with a map, beside which the new session stands.   @return all objects, for who follows the map
MapUpdate restore_objects(const MapState& map, QuadricMapper* mapper);
/// What that returns, for stages that only follow the map.
MapUpdate objects_of(const MapState& map, const Options& options, std::shared_ptr<const ClassTable> classes);

/// Joins two maps of which neither knows where it is in the other: places of both are compared, and what they have in
/// common decides. Objects of both become one.
struct MergedMaps {
  std::shared_ptr<const MapState> map;
  std::vector<LoopClosure> loops;  ///< candidates between the two
  std::size_t kept_loops = 0;      ///< of them
  /// Why the maps are not one: no loop is kept, or what they then have in one place does not agree. A few loops between
  /// places that look alike contradict nothing where no odometry leads from one map to the other; the objects about do.
  Status joined;
};
/// @param options of the stages that judge and solve; loop.mode must be graph
MergedMaps merge_maps(const MapState& a, MapState b, const Options& options, std::shared_ptr<const ClassTable> classes);

/// Takes submaps from the odometry's world to the map, so that a later run can be placed in it.
/// @param keyframes of the last solution, ascending; submaps of later keyframes move with T_map_odom
void move_to_map(const std::vector<KeyframePose>& keyframes, const SE3& T_map_odom, std::vector<LocalMap>* submaps);
/// Takes submaps from the odometry's unit of length to the map's.
void rescale(const std::vector<KeyframePose>& keyframes, std::vector<LocalMap>* submaps);

}  // namespace semantic_topo_loop::core
