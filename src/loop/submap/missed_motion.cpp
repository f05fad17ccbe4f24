#include "loop/submap/missed_motion.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <map>
#include <utility>

#include "geometry/statistics.h"
#include "loop/submap/window_problem.h"
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
/// For so long a motion goes on as it was.
constexpr double kMaxAhead_s = 0.02;
/// Of the squares of what an object moved by: less is left beyond what is common to all if the camera moved.
constexpr double kUnlikeShare = 0.25;

bool stands(const ObservedFrame& from, const ObservedFrame& to) {
  const SE3 motion = from.T_odom_camera.inverse() * to.T_odom_camera;
  return motion.t.norm() < kStill_m && rotation_angle(motion.q, Quaternion::Identity()) < kStill_rad;
}

const ObservedBox* find_box(const ObservedFrame& frame, std::int64_t track_id) {
  const auto found = std::find_if(frame.boxes.begin(), frame.boxes.end(),
                                  [track_id](const ObservedBox& box) { return box.track_id == track_id; });
  return found == frame.boxes.end() ? nullptr : &*found;
}

/// How a box is not where it was to be expected.
struct MovedBox {
  Vec4 by = Vec4::Zero();      ///< its sides, on the plane z = 1
  std::uint8_t truncated = 0;  ///< Truncation bits: these sides bound nothing
  double sigma = 1.0;

  bool bounds(int side) const { return (truncated & (1 << side)) == 0; }
  /// Mean square, in sigmas, of what its sides moved by beyond a shift; nullopt if too few are bounded.
  std::optional<double> squares(const Vec2& shift = Vec2::Zero()) const {
    double sum = 0.0;
    int sides = 0;
    for (int side = 0; side < 4; ++side) {
      if (!bounds(side)) continue;
      const double sigmas = (by(side) - shift(side % 2)) / sigma;
      sum += sigmas * sigmas;
      ++sides;
    }
    if (sides < kMinSides) return std::nullopt;
    return sum / sides;
  }
};

MovedBox moved_box(const ObservedFrame& from, const ObservedBox& before, const ObservedBox& after) {
  return {after.box.edges() - before.box.edges(), static_cast<std::uint8_t>(before.truncated | after.truncated),
          box_sigma(before.box, from.focal_px)};
}

/// By how much most of them moved.
Vec2 common_shift(const std::vector<MovedBox>& boxes) {
  std::array<std::vector<double>, 2> axes;
  for (const MovedBox& box : boxes) {
    for (int side = 0; side < 4; ++side) {
      if (box.bounds(side)) axes[static_cast<std::size_t>(side % 2)].push_back(box.by(side));
    }
  }
  return {axes[0].empty() ? 0.0 : median(std::move(axes[0])), axes[1].empty() ? 0.0 : median(std::move(axes[1]))};
}

/// How the camera turned, if things near its axis appear to be moved by so much.
Quaternion turn_by(const Vec2& shift) { return so3_exp(Vec3(shift.y(), -shift.x(), 0.0)); }

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
        moved_box(window[first], *find_box(window[first], track_id), *find_box(window[last], track_id)).squares();
    if (!squares) continue;
    ++seen;
    moved += *squares > kMovedSigmas * kMovedSigmas ? 1 : 0;
  }
  return moved >= kMinMoved && 2 * moved >= seen;
}

/// By how much known objects are seen elsewhere in a frame than where the odometry puts them since one that was solved
/// for. What the solution, or a detector, is off about a box it is off in both: sigmas learnt of single boxes say too
/// much (with them slips of fr3_office are missed, by 1.4 x in ATE).
/// @param noise of the odometry   @param delay_s by which it is late
std::vector<MovedBox> moved_boxes(const std::deque<ObservedFrame>& window, std::size_t from, std::size_t to,
                                  const WindowSolution& solved, const ShortTermNoise& noise, double delay_s) {
  const double time_s = seconds_into(window, to) - seconds_into(window, from);
  const auto usual = [time_s](double step, double drift) {
    return std::hypot(step * std::sqrt(time_s), drift * time_s);
  };
  const double usual_m = usual(noise.step_m, noise.drift_mps), usual_rad = usual(noise.step_rad, noise.drift_radps);
  const SE3& T_odom_from = *solved.find(window[from].stamp_ns);
  const SE3 T_from_to = pose_at_image(window, from, delay_s).inverse() * pose_at_image(window, to, delay_s);
  std::vector<MovedBox> moved;
  for (const ObservedBox& after : window[to].boxes) {
    const ObservedBox* before = find_box(window[from], after.track_id);
    const auto known = solved.objects.find(after.track_id);
    if (before == nullptr || known == solved.objects.end()) continue;
    MovedBox box = moved_box(window[from], *before, after);
    const SizedPoint object(known->second);
    const auto was = project({0, before->box, box.truncated, 1.0}, T_odom_from, object);
    const auto is = project({0, after.box, box.truncated, 1.0}, T_odom_from * T_from_to, object);
    if (!was || !is || !box.squares()) continue;
    box.by = was->residual - is->residual;
    box.sigma = std::hypot(box.sigma, usual_rad, usual_m / is->in_camera.z());
    moved.push_back(box);
  }
  return moved;
}

/// Whether half of the objects are elsewhere, and what they have in common explains it.
bool camera_moved(const std::vector<MovedBox>& moved) {
  const Vec2 shift = common_shift(moved);
  int off = 0, alike = 0;
  for (const MovedBox& box : moved) {
    const double squares = *box.squares();
    if (!(squares > kMovedSigmas * kMovedSigmas)) continue;
    ++off;
    alike += *box.squares(shift) < kUnlikeShare * squares ? 1 : 0;
  }
  return alike >= kMinMoved && 2 * off >= static_cast<int>(moved.size()) && 2 * alike >= off;
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
  std::vector<MovedBox> moved;
  for (const ObservedBox& after : to.boxes) {
    if (const ObservedBox* before = find_box(from, after.track_id)) moved.push_back(moved_box(from, *before, after));
  }
  return turn_by(common_shift(moved));
}

std::optional<Slip> find_slip(const std::deque<ObservedFrame>& window, const WindowSolution& solved,
                              const ShortTermNoise& noise, const OdometryDelay& delay) {
  if (solved.T_odom_camera.empty()) return std::nullopt;
  // The odometry of what is newer is not known yet, nor was it when the last window was solved.
  const auto is_known = [&delay](std::int64_t stamp_ns, std::int64_t newest_ns) {
    return delay.likely_s() - 1e-9 * static_cast<double>(newest_ns - stamp_ns) < kMaxAhead_s;
  };
  const std::int64_t solved_ns = solved.T_odom_camera.rbegin()->first;
  std::optional<std::size_t> from, to;
  for (std::size_t i = 0; i < window.size(); ++i) {
    const std::int64_t stamp_ns = window[i].stamp_ns;
    if (solved.find(stamp_ns) != nullptr && is_known(stamp_ns, solved_ns)) from = i;
    if (is_known(stamp_ns, window.back().stamp_ns)) to = i;
  }
  if (!from || !to || *from >= *to) return std::nullopt;
  // One that stands may know its way later; what it does not is found otherwise.
  const auto place = [&window](std::size_t i) { return window.begin() + static_cast<std::ptrdiff_t>(i); };
  if (std::adjacent_find(place(*from), place(*to + 1), stands) != place(*to + 1)) return std::nullopt;
  std::vector<MovedBox> moved = moved_boxes(window, *from, *to, solved, noise, delay.likely_s());
  // Where little is known of the delay, it is what moves things in the image of a camera that swings.
  constexpr double kLater_s = 0.05;
  const std::vector<MovedBox> later = moved_boxes(window, *from, *to, solved, noise, delay.likely_s() + kLater_s);
  if (later.size() != moved.size()) return std::nullopt;
  for (std::size_t i = 0; i < moved.size(); ++i) {
    const double by_a_second = 0.5 * (later[i].by - moved[i].by).norm() / kLater_s;  // root mean square of the sides
    moved[i].sigma = std::hypot(moved[i].sigma, delay.sigma_s() * by_a_second);
  }
  if (!camera_moved(moved)) return std::nullopt;
  return Slip{*from, *to, turn_by(common_shift(moved))};
}

}  // namespace semantic_topo_loop::core
