#include "loop/submap/observation_window.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <tuple>
#include <vector>

#include "geometry/depth_points.h"
#include "geometry/statistics.h"
#include "geometry/wide_image.h"
#include "odometry/held_poses.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::int64_t kMemory_ns = 700'000'000;  ///< the detector misses an object for some frames
constexpr std::int64_t kAnswers = 2;              ///< one missed, however slow it is
constexpr double kMinOverlap =
    0.25;  ///< of a box with its track's last, at which a pair is still one object in a fast turn
constexpr double kOtherClassFactor = 0.7;  ///< on the overlap: detectors do rename objects, but seldom
constexpr double kMinDepth = 0.2;          ///< of a ray of depth 1 turned into the present camera: 78 deg off its axis

constexpr std::int64_t kPointInterval_ns = 500'000'000;  ///< a hand-held camera sees new things no sooner
constexpr std::size_t kPointsMax = 2000;  ///< of a frame: one in 5 cm x 5 cm of what a camera sees 2 m away
/// Farther, a structured-light camera's depth is off by more than 3 cm, and its distortion by more still.
constexpr double kMaxRange_m = 4.5;

constexpr double kBoxSigma_px = 1.5, kBoxSigmaShare = 0.02;  ///< the second of the box size

/// Some of the points, evenly taken.
std::shared_ptr<const std::vector<Eigen::Vector3f>> thinned(const std::vector<Vec3>& points_camera) {
  std::size_t step = points_camera.size() / kPointsMax + 1;
  step |= 1;  // odd, so that it does not fall in step with the lines of an even grid
  auto points = std::make_shared<std::vector<Eigen::Vector3f>>();
  points->reserve(points_camera.size() / step + 1);
  for (std::size_t i = 0; i < points_camera.size(); i += step) {
    const Vec3& point = points_camera[i];
    if (point.allFinite() && point.z() > 0.0 && point.z() < kMaxRange_m) points->push_back(point.cast<float>());
  }
  return points;
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

double box_sigma(const Box& box, const Vec2& focal_px) {
  return kBoxSigma_px / focal_px.mean() + kBoxSigmaShare * box.size();
}

std::vector<int> BoxTracker::match(const Quaternion& q_odom_camera, const std::vector<ObservedBox>& boxes) const {
  std::vector<std::tuple<double, int, int>> pairs;  // minus the overlap, track, box
  for (std::size_t t = 0; t < tracks_.size(); ++t) {
    const Track& track = tracks_[t];
    const auto box = turned(track.box, (q_odom_camera.conjugate() * track.q_odom_camera).toRotationMatrix());
    if (!box) continue;
    const int class_id = with_most(track.classes);
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

void BoxTracker::follow(std::int64_t stamp_ns, const Quaternion& q_odom_camera, const std::vector<double>& scores,
                        std::vector<ObservedBox>* boxes) {
  ++answer_;
  const auto is_lost = [this, stamp_ns](const Track& track) {
    return stamp_ns - track.stamp_ns > kMemory_ns && answer_ - track.answer > kAnswers;
  };
  tracks_.erase(std::remove_if(tracks_.begin(), tracks_.end(), is_lost), tracks_.end());
  const std::vector<int> track_of = match(q_odom_camera, *boxes);
  for (std::size_t b = 0; b < boxes->size(); ++b) {
    ObservedBox& box = (*boxes)[b];
    if (track_of[b] < 0) {
      tracks_.emplace_back();
      tracks_.back().id = next_id_++;
    }
    Track& track = track_of[b] < 0 ? tracks_.back() : tracks_[static_cast<std::size_t>(track_of[b])];
    track.stamp_ns = stamp_ns;
    track.answer = answer_;
    track.q_odom_camera = q_odom_camera;
    track.box = box.box;
    track.classes[box.class_id] += scores[b];
    box.track_id = track.id;
    box.class_id = with_most(track.classes);
  }
}

ObservationWindow::ObservationWindow(double span_s, double interval_s, ClassTable classes)
    : span_ns_(std::llround(1e9 * span_s)),
      interval_ns_(std::llround(1e9 * interval_s)),
      classes_(std::move(classes)) {}

bool ObservationWindow::push(const Frame& frame, const AssociationFrame& associations) {
  if (frame.is_break) clear();
  for (ObservedFrame& f : frames_) f.T_odom_camera = pose_on_the_way(f.stamp_ns, f.T_odom_camera, frame);
  if (associations.unanswered) return false;
  ObservedFrame observed = observe(frame, associations);
  const bool sampled = frames_.empty() || frame.stamp_ns - last_sampled_ns_ >= interval_ns_;
  if (sampled) last_sampled_ns_ = frame.stamp_ns;
  const bool taken = sampled || frame.is_keyframe;
  if (taken && frame.points_camera && (frames_.empty() || frame.stamp_ns - last_points_ns_ >= kPointInterval_ns)) {
    observed.points = thinned(*frame.points_camera);
    observed.features = frame.features;
    last_points_ns_ = frame.stamp_ns;
  }
  if (taken) frames_.push_back(std::move(observed));
  while (!frames_.empty() && frame.stamp_ns - frames_.front().stamp_ns > span_ns_) frames_.pop_front();
  return taken;
}

void ObservationWindow::set_span(double span_s) { span_ns_ = std::llround(1e9 * span_s); }

/// Every frame is followed, also those that are left out.
ObservedFrame ObservationWindow::observe(const Frame& frame, const AssociationFrame& associations) {
  const Camera& camera = frame.camera;
  ObservedFrame observed;
  observed.frame_id = frame.frame_id;
  observed.keyframe_id = frame.keyframe_id;
  observed.stamp_ns = frame.stamp_ns;
  observed.is_keyframe = frame.is_keyframe;
  observed.T_odom_camera = frame.T_odom_camera;
  observed.focal_px = Vec2(camera.fx, camera.fy) / pixel_factor(camera);
  const auto normalised = [&camera](const Box& box) {
    const Vec3 low = camera.ray({box.x1, box.y1}), high = camera.ray({box.x2, box.y2});
    return Box{low.x(), low.y(), high.x(), high.y()};
  };
  observed.image = normalised(camera.image());
  std::vector<double> scores;
  for (const Association& association : associations.associations) {
    if (association.landmark_id < 0 || !association.box.is_valid() || classes_.label(association.class_id) < 0)
      continue;
    scores.push_back(association.score);
    const Box box = normalised(association.box);
    const double thickness_m = 0.5 * association.near_m * std::min(box.width(), box.height());
    observed.boxes.push_back({association.landmark_id, -1, -1, association.class_id, box, association.truncated,
                              association.has_depth() ? association.near_m + near_side_m(thickness_m) : 0.0});
  }
  tracker_.follow(frame.stamp_ns, frame.T_odom_camera.q, scores, &observed.boxes);
  for (ObservedBox& box : observed.boxes) box.label = classes_.label(box.class_id);
  return observed;
}

SE3 pose_at_image(const std::deque<ObservedFrame>& window, std::size_t frame, double delay_s) {
  constexpr double kMinBaseline_s = 0.05;  // over which a motion goes on; closer frames' jitter would grow
  if (delay_s == 0.0) return window[frame].T_odom_camera;
  const auto seconds_after = [&window, frame](std::size_t i) {
    return 1e-9 * static_cast<double>(window[i].stamp_ns - window[frame].stamp_ns);
  };
  std::size_t after = 1;
  while (after + 1 < window.size() && seconds_after(after) <= delay_s) ++after;
  std::size_t before = after - 1;
  const auto is_short = [&] { return seconds_after(after) - seconds_after(before) < kMinBaseline_s; };
  while (before > 0 && seconds_after(after) < delay_s && is_short()) --before;
  while (after + 1 < window.size() && seconds_after(before) > delay_s && is_short()) ++after;
  const double begin_s = seconds_after(before), span_s = seconds_after(after) - begin_s;
  if (!(span_s > 0.0)) return window[frame].T_odom_camera;
  return interpolate(window[before].T_odom_camera, window[after].T_odom_camera, (delay_s - begin_s) / span_s);
}

std::deque<ObservedFrame> undelayed(std::deque<ObservedFrame> window, double delay_s) {
  if (delay_s == 0.0) return window;
  std::vector<SE3> T_odom_camera;
  T_odom_camera.reserve(window.size());
  for (std::size_t i = 0; i < window.size(); ++i) T_odom_camera.push_back(pose_at_image(window, i, delay_s));
  for (std::size_t i = 0; i < window.size(); ++i) window[i].T_odom_camera = T_odom_camera[i];
  return window;
}

}  // namespace semantic_topo_loop::core
