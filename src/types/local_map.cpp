#include "semantic_topo_loop/types/local_map.h"

#include <cmath>

namespace semantic_topo_loop::core {

LocalMap rescaled(LocalMap map, double scale) {
  for (LocalFrame& frame : map.frames) {
    frame.position *= scale;
    frame.t_camera_local *= scale;
  }
  for (LocalObject& object : map.objects) {
    object.spheroid.center *= scale;
    object.spheroid.log_axes.array() += std::log(scale);
    object.covariance *= scale * scale;
  }
  return map;
}

}  // namespace semantic_topo_loop::core
