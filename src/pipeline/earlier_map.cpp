#include "semantic_topo_loop/pipeline/earlier_map.h"

#include <algorithm>
#include <utility>

namespace semantic_topo_loop::core {

namespace {

/// Of what comes after the last solution.
double latest_scale(const std::vector<KeyframePose>& keyframes) {
  return keyframes.empty() ? 1.0 : keyframes.back().scale;
}

}  // namespace

void move_to_map(const std::vector<KeyframePose>& keyframes, const SE3& T_map_odom, std::vector<LocalMap>* submaps) {
  for (LocalMap& submap : *submaps) {
    const auto pose =
        std::lower_bound(keyframes.begin(), keyframes.end(), submap.keyframe_id,
                         [](const KeyframePose& keyframe, std::int64_t id) { return keyframe.keyframe_id < id; });
    const bool solved = pose != keyframes.end() && pose->keyframe_id == submap.keyframe_id;
    const double scale = solved ? pose->scale : latest_scale(keyframes);
    if (scale != 1.0) submap = rescaled(std::move(submap), scale);
    submap.T_odom_anchor = solved ? pose->T_map_camera : T_map_odom * submap.T_odom_anchor;
  }
}

}  // namespace semantic_topo_loop::core
