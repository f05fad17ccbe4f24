#include "map/mapper_state.h"

namespace semantic_topo_loop::core {

void MapperState::move_to(const Camera& other) {
  const bool is_same = camera.fx == other.fx && camera.fy == other.fy && camera.cx == other.cx && camera.cy == other.cy;
  const auto moved = [&](double x, double y) -> Vec2 { return other.pixel(camera.ray({x, y})); };
  for (MappedLandmark& landmark : landmarks) {
    for (Observation& observation : landmark.observations) {
      if (is_same) break;
      Box& box = observation.view.box;
      const Vec2 low = moved(box.x1, box.y1), high = moved(box.x2, box.y2);
      box = {low.x(), low.y(), high.x(), high.y()};
    }
  }
  camera = other;
}

}  // namespace semantic_topo_loop::core
