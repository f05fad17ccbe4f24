#include "loop/submap/frozen_odometry.h"

#include <algorithm>
#include <cstddef>
#include <map>
#include <utility>

#include "geometry/statistics.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

/// An odometry stands if it moves by less between two frames: boxes tell no smaller motion.
constexpr double kStill_m = 0.001, kStill_rad = 0.001;
/// What is judged at a time: for longer, a standing camera sees things pass.
constexpr std::int64_t kStretch_ns = 1'500'000'000;
constexpr double kMovedSigmas = 4.0;  ///< of a box's sides, root mean square
constexpr int kMinSides = 2;          ///< that both boxes of a track bound
constexpr int kMinMoved = 2;          ///< tracks: a single thing may move by itself

bool stands(const ObservedFrame& from, const ObservedFrame& to) {
  const SE3 motion = from.T_odom_camera.inverse() * to.T_odom_camera;
  return motion.t.norm() < kStill_m && rotation_angle(motion.q, Quaternion::Identity()) < kStill_rad;
}

const ObservedBox* find_box(const ObservedFrame& frame, std::int64_t track_id) {
  const auto found = std::find_if(frame.boxes.begin(), frame.boxes.end(),
                                  [track_id](const ObservedBox& box) { return box.track_id == track_id; });
  return found == frame.boxes.end() ? nullptr : &*found;
}

bool bound(const ObservedBox& p, const ObservedBox& q, int side) {
  return ((p.truncated | q.truncated) & (1 << side)) == 0;
}

/// Mean square of what the sides moved by, in sigmas; nullopt if too few are bounded.
std::optional<double> squared_motion(const ObservedFrame& from, const ObservedBox& before, const ObservedBox& after) {
  const Vec4 moved = (after.box.edges() - before.box.edges()) / box_sigma(before.box, from.focal_px);
  double squares = 0.0;
  int sides = 0;
  for (int side = 0; side < 4; ++side) {
    if (!bound(before, after, side)) continue;
    squares += moved(side) * moved(side);
    ++sides;
  }
  if (sides < kMinSides) return std::nullopt;
  return squares / sides;
}

/// True if most of what is in view for at least half of the frames from begin to end moved meanwhile.
bool view_moved(const std::deque<ObservedFrame>& window, std::size_t begin, std::size_t end) {
  std::map<std::int64_t, std::pair<std::size_t, std::size_t>> spans;  // first and last frame of each track
  for (std::size_t i = begin; i <= end; ++i) {
    for (const ObservedBox& box : window[i].boxes)
      spans.emplace(box.track_id, std::pair(i, i)).first->second.second = i;
  }
  int seen = 0, moved = 0;
  for (const auto& [track_id, span] : spans) {
    const auto [first, last] = span;
    if (first == last || 2 * (last - first) < end - begin) continue;
    const auto squares =
        squared_motion(window[first], *find_box(window[first], track_id), *find_box(window[last], track_id));
    if (!squares) continue;
    ++seen;
    moved += *squares > kMovedSigmas * kMovedSigmas ? 1 : 0;
  }
  return moved >= kMinMoved && 2 * moved >= seen;
}

}  // namespace

std::vector<bool> frozen_motions(const std::deque<ObservedFrame>& window) {
  std::vector<bool> frozen(window.size(), false);
  for (std::size_t begin = 0, end = 0; begin + 1 < window.size(); begin = std::max(end, begin + 1)) {
    end = begin;
    while (end + 1 < window.size() && window[end + 1].stamp_ns - window[begin].stamp_ns <= kStretch_ns &&
           stands(window[end], window[end + 1])) {
      ++end;
    }
    if (end == begin || !view_moved(window, begin, end)) continue;
    std::fill(frozen.begin() + static_cast<std::ptrdiff_t>(begin), frozen.begin() + static_cast<std::ptrdiff_t>(end),
              true);
  }
  return frozen;
}

std::optional<std::int64_t> last_frozen_ns(const std::deque<ObservedFrame>& window) {
  const std::vector<bool> frozen = frozen_motions(window);
  const auto last = std::find(frozen.rbegin(), frozen.rend(), true);
  if (last == frozen.rend()) return std::nullopt;
  return window[static_cast<std::size_t>(frozen.rend() - last)].stamp_ns;
}

Quaternion turn_by_boxes(const ObservedFrame& from, const ObservedFrame& to) {
  std::vector<double> x, y;
  for (const ObservedBox& after : to.boxes) {
    const ObservedBox* before = find_box(from, after.track_id);
    if (before == nullptr) continue;
    const Vec4 moved = after.box.edges() - before->box.edges();
    for (int side = 0; side < 4; ++side) {
      if (bound(*before, after, side)) (side % 2 == 0 ? x : y).push_back(moved(side));
    }
  }
  Vec3 turn = Vec3::Zero();
  if (!x.empty()) turn.y() = -median(std::move(x));
  if (!y.empty()) turn.x() = median(std::move(y));
  return so3_exp(turn);
}

}  // namespace semantic_topo_loop::core
