#include "semantic_topo_loop/pipeline/object_slam.h"

#include <algorithm>

#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop::core {
ObjectSlam::ObjectSlam(const Options& options, std::shared_ptr<const ClassTable> classes)
    : associator_(options.association, classes),
      mapper_(options.mapping, classes),
      loop_detector_(options.loop, classes),
      pose_graph_(options.pose_graph) {}

FrameResult ObjectSlam::process(const Frame& frame, const std::vector<Detection>* detections,
                                const std::vector<LoopClosure>& extra_loops) {
  const auto tell = [this](const MapUpdate& update) {
    associator_.apply(update);
    loop_detector_.apply(update);
    pose_graph_.apply(update);
  };
  FrameResult result;
  result.associations = detections != nullptr ? associator_.associate(frame, *detections) : associator_.pass(frame);
  result.observation = mapper_.integrate(frame, result.associations);
  tell(result.observation);
  const Stopwatch stopwatch;
  result.loops = loop_detector_.detect(frame, result.associations);
  result.loop_us = stopwatch.elapsed_us();
  pose_graph_.refine(loop_detector_.motions());
  pose_graph_.observe(frame, result.associations);
  result.correction = pose_graph_.process(frame, result.loops, extra_loops);
  result.completion = mapper_.apply(result.correction);
  tell(result.completion);
  return result;
}

std::vector<LocalMap> ObjectSlam::submaps_in_map() const {
  std::vector<LocalMap> submaps = loop_detector_.submaps();
  move_to_map(pose_graph_.keyframes(), pose_graph_.T_map_odom(), &submaps);
  return submaps;
}

void move_to_map(const std::vector<KeyframePose>& keyframes, const SE3& T_map_odom, std::vector<LocalMap>* submaps) {
  const double last_scale = keyframes.empty() ? 1.0 : keyframes.back().scale;  // of what comes after the last solution
  for (LocalMap& submap : *submaps) {
    const auto pose =
        std::lower_bound(keyframes.begin(), keyframes.end(), submap.keyframe_id,
                         [](const KeyframePose& keyframe, std::int64_t id) { return keyframe.keyframe_id < id; });
    const bool solved = pose != keyframes.end() && pose->keyframe_id == submap.keyframe_id;
    const double scale = solved ? pose->scale : last_scale;
    if (scale != 1.0) submap = rescaled(std::move(submap), scale);
    submap.T_odom_anchor = solved ? pose->T_map_camera : T_map_odom * submap.T_odom_anchor;
  }
}

}  // namespace semantic_topo_loop::core
