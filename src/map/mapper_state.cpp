#include "map/mapper_state.h"

namespace semantic_topo_loop::core {

bool move_boxes(const Camera& from, const Camera& to, std::vector<Observation>* observations) {
  if (from.fx == to.fx && from.fy == to.fy && from.cx == to.cx && from.cy == to.cy) return false;
  const auto moved = [&](double x, double y) -> Vec2 { return to.pixel(from.ray({x, y})); };
  for (Observation& observation : *observations) {
    Box& box = observation.view.box;
    const Vec2 low = moved(box.x1, box.y1), high = moved(box.x2, box.y2);
    box = {low.x(), low.y(), high.x(), high.y()};
  }
  return true;
}

}  // namespace semantic_topo_loop::core
