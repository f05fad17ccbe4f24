#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// Seconds in decimal text ("1311868164.363181", also with an exponent) to nanoseconds, never through a double.
/// Digits below a nanosecond are rounded.
/// @return nullopt if the text is no non-negative decimal number or exceeds int64 nanoseconds
std::optional<std::int64_t> parse_stamp(std::string_view text);

/// Nanoseconds to seconds in decimal text: 6 decimals, or 9 where they are needed, so that parse_stamp gives the same
/// stamp back.
std::string format_stamp(std::int64_t stamp_ns);

/// A camera pose of a trajectory, in the frame that the trajectory states: the world of ground truth, odom of odometry.
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

/// Wall time since construction. For reports only: no decision depends on it.
class Stopwatch {
 public:
  double elapsed_us() const {
    return std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - start_).count();
  }

 private:
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

}  // namespace semantic_topo_loop::core
