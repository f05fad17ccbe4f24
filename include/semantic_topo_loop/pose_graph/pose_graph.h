#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <vector>

#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/landmark.h"
#include "semantic_topo_loop/types/loop_closure.h"
#include "semantic_topo_loop/types/map_correction.h"
#include "semantic_topo_loop/types/solved_motion.h"

namespace semantic_topo_loop::core {

struct GraphDelta;
struct GraphState;
struct PoseGraphOptions;

/// Owns the keyframe poses and map_from_odom: takes in odometry and loops, optimises, and says what moved. As things
/// are:
///   0. in a long run the past comes in coarse steps (`coarsen` in src/pose_graph/solver), and each place keeps its
///      best loops (`LoopRejection::bound`), so that a solution costs the same after hours; not with a free scale;
///   1. frames become vertices and odometry edges, with the jumps that their motion lets suspect (src/odometry); the
///      loop detector's solved motions take the place of the odometry's;
///   2. loops are rejected (src/pose_graph/rejection): pairwise consistency, robust solve, final audit;
///   3. the odometry's noise is learnt from the loops that are kept, and poses are solved for at that noise
///      (src/pose_graph/solver), then once more with the objects;
///   4. where the odometry's unit of length drifts, 2 and 3 work in the map's unit, and poses and scales are solved for
///      together (src/pose_graph/scale).
class PoseGraph {
 public:
  explicit PoseGraph(const PoseGraphOptions& options);

  /// What the objects are tied by (pose_graph.objects): give it before `process` of the same frame. Nothing happens
  /// while objects take no part.
  void observe(const Frame& frame, const AssociationFrame& associations);
  /// Follows the map. @param update of the frame before, or of this one before `process`
  void apply(const MapUpdate& update);
  /// Puts solved motions in the place of the odometry's, but for breaks and where the odometry's source states how good
  /// it is. Motions between keyframes that are not known, or no neighbours, are left out.
  void refine(const std::vector<SolvedMotion>& motions);
  /// Adds the frame's keyframe and odometry edge and the accepted loops, but for those into an earlier run's map;
  /// optimises when there is reason to: at an end frame, where there is anything but the odometry's own motions.
  /// @param extra_loops loops from outside, treated alike
  MapCorrection process(const Frame& frame, const std::vector<LoopClosure>& loops,
                        const std::vector<LoopClosure>& extra_loops = {});
  /// What a later session goes on with (src/pose_graph/graph_state.h). Objects' boxes are not part of it, see `recall`.
  GraphState state() const;
  /// What is new in it since this was called last. @param whole give all of it again
  GraphDelta take_delta(bool whole);
  /// Goes on with earlier sessions' graph; the odometry of this one has nothing to do with theirs. Call it before the
  /// first frame.
  /// @param begin_at where its first camera stands as long as no loop tells, map frame, m; without, the odometry's
  /// frame is the map's
  void restore(GraphState state, const std::optional<Vec3>& begin_at = {});
  /// Remembers an earlier session's boxes of objects, after `restore`, in ascending order of keyframes. Those in
  /// keyframes that are no vertices are left out.
  /// @param camera undistorted, whose pixels the boxes are in
  void recall(std::int64_t keyframe_id, const Camera& camera, const AssociationFrame& associations);
  /// Takes the accepted loops between two keyframes out again; the next frame optimises without them.
  /// @return false if none is remembered: those that repeat others are forgotten in time
  bool withdraw(std::int64_t query_keyframe_id, std::int64_t match_keyframe_id);
  /// From the next frame on. @param options those that it has, but for live ones
  void set_options(const PoseGraphOptions& options);
  const SE3& T_map_odom() const;
  /// What a solution costs time for: bounded, however long the run is and however many loops it finds.
  struct Size {
    std::size_t vertices = 0, loops = 0;
  };
  Size size() const;
  /// Every keyframe, in order of id.
  std::vector<KeyframePose> keyframes() const;

 private:
  struct Impl;
  std::unique_ptr<Impl, void (*)(Impl*)> impl_;
};

}  // namespace semantic_topo_loop::core
