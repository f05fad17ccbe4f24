#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "semantic_topo_loop/types/se3.h"

namespace semantic_topo_loop::core {

struct StampedPose {
  std::int64_t stamp_ns = 0;
  SE3 T_world_camera;
};

/// Poses in order of strictly increasing stamps.
using StampedPoses = std::vector<StampedPose>;

/// The element whose `stamp_ns` is nearest, the earlier one of two equally near.
/// @param sorted in order of `stamp_ns`   @param tolerance_ns largest accepted difference
/// @return null if none is within the tolerance
template <class Stamped>
const Stamped* find_stamp(const std::vector<Stamped>& sorted, std::int64_t stamp_ns, std::int64_t tolerance_ns) {
  const auto after = std::lower_bound(sorted.begin(), sorted.end(), stamp_ns,
                                      [](const Stamped& element, std::int64_t ns) { return element.stamp_ns < ns; });
  const Stamped* best = nullptr;
  std::int64_t smallest = tolerance_ns;
  if (after != sorted.end() && after->stamp_ns - stamp_ns <= smallest) {
    best = &*after;
    smallest = after->stamp_ns - stamp_ns;
  }
  if (after != sorted.begin() && stamp_ns - std::prev(after)->stamp_ns <= smallest) best = &*std::prev(after);
  return best;
}

}  // namespace semantic_topo_loop::core
