#include "semantic_topo_loop/pipeline/object_slam.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include "pipeline/map_changes.h"
#include "pipeline/map_state.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop::core {
namespace {

/// @param keyframes ascending   @return null if it is unknown
const KeyframePose* find_keyframe(const std::vector<KeyframePose>& keyframes, std::int64_t id) {
  const auto found =
      std::lower_bound(keyframes.begin(), keyframes.end(), id,
                       [](const KeyframePose& keyframe, std::int64_t other) { return keyframe.keyframe_id < other; });
  return found != keyframes.end() && found->keyframe_id == id ? &*found : nullptr;
}

}  // namespace

ObjectSlam::ObjectSlam(const Options& options, std::shared_ptr<const ClassTable> classes)
    : associator_(options.association, classes),
      mapper_(options.mapping, classes),
      loop_detector_(options.loop, classes),
      pose_graph_(options.pose_graph) {}

void ObjectSlam::tell(const MapUpdate& update) {
  associator_.apply(update);
  loop_detector_.apply(update);
  pose_graph_.apply(update);
}

FrameResult ObjectSlam::process(const Frame& frame, const std::vector<Detection>* detections,
                                const std::vector<LoopClosure>& extra_loops) {
  FrameResult result;
  result.associations = detections != nullptr ? associator_.associate(frame, *detections) : associator_.pass(frame);
  result.observation = mapper_.integrate(frame, result.associations);
  tell(result.observation);
  const Stopwatch stopwatch;
  result.loops = loop_detector_.detect(frame, result.associations);
  result.loop_us = stopwatch.elapsed_us();
  result.relocalisation = loop_detector_.relocalisation();
  pose_graph_.refine(loop_detector_.motions());
  pose_graph_.observe(frame, result.associations);
  result.correction = pose_graph_.process(frame, result.loops, extra_loops);
  result.completion = mapper_.apply(result.correction);
  tell(result.completion);
  return result;
}

MapUpdate ObjectSlam::restore(const MapState& map) {
  const MapUpdate update = restore_objects(map, &mapper_);
  loop_detector_.restore(map.submaps_in_parts(), map.keyframe_poses(), map.refused);
  restore_graph(map, &pose_graph_);
  tell(update);
  return update;
}

std::shared_ptr<const MapState> ObjectSlam::map() const {
  auto map = std::make_shared<MapState>();
  map->graph = pose_graph_.state();
  map->objects = mapper_.state();
  map->submaps = loop_detector_.submaps();
  move_to_map(map->keyframe_poses(), pose_graph_.T_map_odom(), &map->submaps);
  map->refused = loop_detector_.refused();
  return map;
}

std::shared_ptr<const MapDelta> ObjectSlam::take_delta() {
  auto delta = std::make_shared<MapDelta>();
  delta->graph = pose_graph_.take_delta(false);
  delta->objects = mapper_.take_delta(false);
  delta->submaps = loop_detector_.take_delta(false);
  return delta;
}

void restore_graph(const MapState& map, PoseGraph* graph) {
  graph->restore(map.graph, place_beside(map));
  for (const auto& [keyframe_id, associations] : boxes_in_keyframes(map)) {
    graph->recall(keyframe_id, map.objects.camera, associations);
  }
}

MapUpdate restore_objects(const MapState& map, QuadricMapper* mapper) {
  MapUpdate update = mapper->restore(map.objects, map.keyframe_poses(), place_beside(map));
  update.frame_id = map.graph.next_frame_id;
  return update;
}

MapUpdate objects_of(const MapState& map, const Options& options, std::shared_ptr<const ClassTable> classes) {
  QuadricMapper mapper(options.mapping, std::move(classes));
  return restore_objects(map, &mapper);
}

void move_to_map(const std::vector<KeyframePose>& keyframes, const SE3& T_map_odom, std::vector<LocalMap>* submaps) {
  for (LocalMap& submap : *submaps) {
    const KeyframePose* pose = find_keyframe(keyframes, submap.keyframe_id);
    submap.T_odom_anchor = pose != nullptr ? pose->T_map_camera : T_map_odom * submap.T_odom_anchor;
  }
}

void rescale(const std::vector<KeyframePose>& keyframes, std::vector<LocalMap>* submaps) {
  const double last_scale = keyframes.empty() ? 1.0 : keyframes.back().scale;  // of what comes after the last solution
  for (LocalMap& submap : *submaps) {
    const KeyframePose* pose = find_keyframe(keyframes, submap.keyframe_id);
    const double scale = pose != nullptr ? pose->scale : last_scale;
    if (scale != 1.0) submap = rescaled(std::move(submap), scale);
  }
}

namespace {

/// What holds for a loop holds for what it joins: enough objects in common, and most of what one side has where the
/// other looked.
Status check_join(const MergedMaps& merged, std::int64_t first_of_b, const LoopOptions& options) {
  if (merged.kept_loops == 0) {
    return Error{"no place in common that " + std::to_string(merged.loops.size()) + " candidates agree on"};
  }
  constexpr double kMost = 0.5;
  const MapAgreement agreement = map_agreement(*merged.map, first_of_b);
  if (agreement.common >= options.min_inliers && agreement.ratio() > kMost) return {};
  return Error{"places that look alike, but are not the same: where " + std::to_string(merged.kept_loops) +
               " loops put them, " + std::to_string(agreement.common) + " objects are of both, and " +
               std::to_string(agreement.only_first) + " and " + std::to_string(agreement.only_second) +
               " of one that the other should have seen"};
}

}  // namespace

MergedMaps merge_maps(const MapState& a, MapState b, const Options& options,
                      std::shared_ptr<const ClassTable> classes) {
  MapState both = a;
  both.append(std::move(b));
  const auto theirs = both.submaps.begin() + static_cast<std::ptrdiff_t>(a.submaps.size());
  const std::vector<LocalMap> queries(theirs, both.submaps.end());
  LoopDetector detector(options.loop, classes);
  detector.restore(a.submaps_in_parts(), a.keyframe_poses(), {});
  MergedMaps merged;
  merged.loops = detector.detect(queries);

  ObjectSlam slam(options, std::move(classes));
  slam.restore(both);
  Frame end;
  end.is_end = true;
  end.frame_id = both.graph.next_frame_id;
  slam.mapper_.integrate(end, slam.associator_.pass(end));
  const MapCorrection correction = slam.pose_graph_.process(end, merged.loops);
  slam.mapper_.apply(correction);
  const std::int64_t first_of_b = a.graph.next_keyframe_id();
  for (const LoopVerdict& verdict : correction.loops) {
    const bool is_between = verdict.match_keyframe_id < first_of_b && verdict.query_keyframe_id >= first_of_b;
    merged.kept_loops += is_between && verdict.kept ? 1 : 0;
  }
  auto map = std::make_shared<MapState>(*slam.map());
  map->points = std::move(both.points);  // of the same keyframes, which they follow
  std::copy_if(merged.loops.begin(), merged.loops.end(), std::back_inserter(map->refused),
               [](const LoopClosure& loop) { return !loop.accepted && is_finite(loop); });
  merged.map = std::move(map);
  merged.joined = check_join(merged, first_of_b, options.loop);
  return merged;
}

}  // namespace semantic_topo_loop::core
