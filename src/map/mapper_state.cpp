#include "map/mapper_state.h"

#include <cmath>
#include <iterator>
#include <set>

namespace semantic_topo_loop::core {

bool move_boxes(const Camera& from, const Camera& to, MappedLandmark* landmark) {
  if (from.fx == to.fx && from.fy == to.fy && from.cx == to.cx && from.cy == to.cy) return false;
  const auto moved = [&](double x, double y) -> Vec2 { return to.pixel(from.ray({x, y})); };
  for (Observation& observation : landmark->observations) {
    Box& box = observation.view.box;
    const Vec2 low = moved(box.x1, box.y1), high = moved(box.x2, box.y2);
    box = {low.x(), low.y(), high.x(), high.y()};
  }
  landmark->seen_from.scale(std::sqrt(to.fx * to.fy / (from.fx * from.fy)));
  return true;
}

void forget_gone_neighbours(std::vector<MappedLandmark>* landmarks) {
  std::set<std::int64_t> known;
  for (const MappedLandmark& landmark : *landmarks) known.insert(landmark.state.id);
  for (MappedLandmark& landmark : *landmarks) {
    for (auto next = landmark.seen_beside.begin(); next != landmark.seen_beside.end();) {
      next = known.count(next->first) > 0 ? std::next(next) : landmark.seen_beside.erase(next);
    }
  }
}

}  // namespace semantic_topo_loop::core
