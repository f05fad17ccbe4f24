#include "loop/graph/box_tracker.h"

#include <algorithm>
#include <optional>
#include <tuple>

namespace semantic_topo_loop::core {
namespace {

constexpr std::int64_t kMemoryNs = 700'000'000;  ///< the detector misses an object for some frames
constexpr double kMinOverlap = 0.25;
constexpr double kOtherClassFactor = 0.7;  ///< on the overlap: detectors do rename objects, but seldom
constexpr double kMinDepth = 0.2;          ///< of a ray turned into the present camera

int commonest(const std::map<int, double>& classes) {
  return std::max_element(classes.begin(), classes.end(),
                          [](const auto& p, const auto& q) { return p.second < q.second; })
      ->first;
}

/// Where a box appears after the camera turned; nothing if it left the field of view.
std::optional<Box> turned(const Box& box, const Mat3& R_now_then) {
  const Vec2 center = box.center();
  const Vec3 ray = R_now_then * Vec3(center.x(), center.y(), 1.0);
  if (ray.z() < kMinDepth) return std::nullopt;
  const double x = ray.x() / ray.z(), y = ray.y() / ray.z(), w = 0.5 * box.width(), h = 0.5 * box.height();
  return Box{x - w, y - h, x + w, y + h};
}

}  // namespace

std::vector<int> BoxTracker::match(const Quaternion& q_odom_camera, const std::vector<TrackedBox>& boxes) const {
  std::vector<std::tuple<double, int, int>> pairs;  // minus the overlap, track, box
  for (std::size_t t = 0; t < tracks_.size(); ++t) {
    const Track& track = tracks_[t];
    const auto box = turned(track.box, (q_odom_camera.conjugate() * track.q_odom_camera).toRotationMatrix());
    if (!box) continue;
    const int class_id = commonest(track.classes);
    for (std::size_t b = 0; b < boxes.size(); ++b) {
      const double factor = boxes[b].class_id == class_id ? 1.0 : kOtherClassFactor;
      const double overlap = factor * iou(*box, boxes[b].box);
      if (overlap >= kMinOverlap) pairs.emplace_back(-overlap, static_cast<int>(t), static_cast<int>(b));
    }
  }
  std::sort(pairs.begin(), pairs.end());
  std::vector<int> track_of(boxes.size(), -1);
  std::vector<bool> is_taken(tracks_.size(), false);
  for (const auto& [overlap, t, b] : pairs) {
    if (is_taken[static_cast<std::size_t>(t)] || track_of[static_cast<std::size_t>(b)] >= 0) continue;
    is_taken[static_cast<std::size_t>(t)] = true;
    track_of[static_cast<std::size_t>(b)] = t;
  }
  return track_of;
}

void BoxTracker::follow(std::int64_t stamp_ns, const Quaternion& q_odom_camera, std::vector<TrackedBox>* boxes) {
  const auto is_lost = [stamp_ns](const Track& track) { return stamp_ns - track.stamp_ns > kMemoryNs; };
  tracks_.erase(std::remove_if(tracks_.begin(), tracks_.end(), is_lost), tracks_.end());
  const std::vector<int> track_of = match(q_odom_camera, *boxes);
  for (std::size_t b = 0; b < boxes->size(); ++b) {
    TrackedBox& box = (*boxes)[b];
    if (track_of[b] < 0) {
      tracks_.emplace_back();
      tracks_.back().id = next_id_++;
    }
    Track& track = track_of[b] < 0 ? tracks_.back() : tracks_[static_cast<std::size_t>(track_of[b])];
    track.stamp_ns = stamp_ns;
    track.q_odom_camera = q_odom_camera;
    track.box = box.box;
    track.classes[box.class_id] += box.score;
    box.track_id = track.id;
    box.track_class_id = commonest(track.classes);
  }
}

}  // namespace semantic_topo_loop::core
