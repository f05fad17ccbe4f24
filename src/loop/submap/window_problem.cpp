#include "loop/submap/window_problem.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace semantic_topo_loop::core {
namespace {

// Chosen on the shared drifted_real files of fr2_desk and fr3_office, judged on those in drifted, which are made
// differently.
constexpr double kKnotInterval_s = 0.45;  ///< poses are solved for this often: boxes of closer frames are off alike
constexpr double kDriftSpan_s = 3.0;      ///< for which a drift lasts
/// m/s and rad/s: how a camera may move while the odometry does not follow it, and nothing else tells.
constexpr double kUnseenRate = 0.5;
constexpr int kMaxCutSides = 2;
constexpr double kMinDepth_m = 0.15;  ///< of an object before the camera

Vec6 variances(double translation, double rotation) {
  Vec6 values;
  values << Vec3::Constant(translation * translation), Vec3::Constant(rotation * rotation);
  return values;
}

/// What the views make of an object's place, up to a constant.
/// @param enough costs above need not be told apart
double start_cost(const std::vector<WindowView>& views, const std::vector<SE3>& T_odom_knot, const Vec5& object,
                  double depth_m, double enough) {
  constexpr double kUsual_m = 2.0, kUsualWeight = 0.1;  // hardly any: where nothing else tells
  constexpr double kTolerance = 3.0;                    // times the sigmas: the odometry is as it is
  constexpr double kLargeFactor = 1e3;
  const SizedPoint sized(object);
  const double log_depth = std::log(depth_m / kUsual_m);
  double cost = kUsualWeight * log_depth * log_depth;
  double factor = 1.0;                                               // of several views, for one logarithm
  for (std::size_t i = 0; i < views.size() && cost < enough; ++i) {  // no view makes it less
    const auto projection = project(views[i], T_odom_knot[views[i].knot], sized);
    factor *= 1.0 + (projection ? projection->residual.squaredNorm() : kUnseenChi2) / (2.0 * kTolerance * kTolerance);
    if (factor < kLargeFactor && i + 1 < views.size()) continue;
    cost += std::log(factor);
    factor = 1.0;
  }
  return cost;
}

/// Where the object is known to be, or the depth along the ray of the wholest view, whichever all views agree on best.
Vec5 start_of(const std::vector<WindowView>& views, const std::vector<SE3>& T_odom_knot,
              const std::optional<Vec5>& known) {
  const WindowView& wholest =
      *std::min_element(views.begin(), views.end(),
                        [](const WindowView& p, const WindowView& q) { return p.cut_sides() < q.cut_sides(); });
  constexpr double kNearest_m = 0.5, kFarthest_m = 6.0, kRatio = 1.2;
  const SE3& T_odom_camera = T_odom_knot[wholest.knot];
  const Vec2 center = wholest.box.center();
  Vec5 best = Vec5::Zero();
  double least = std::numeric_limits<double>::infinity();
  const auto try_at = [&](double z, const Vec5& object) {
    const double cost = start_cost(views, T_odom_knot, object, z, least);
    if (cost >= least) return;
    least = cost;
    best = object;
  };
  if (known) {
    const double z = (T_odom_camera.inverse() * Vec3(known->head<3>())).z();
    if (z > kMinDepth_m) try_at(z, *known);
  }
  for (double z = kNearest_m; z < kFarthest_m; z *= kRatio) {
    Vec5 object;
    object << T_odom_camera * Vec3(z * center.x(), z * center.y(), z), std::log(0.5 * z * wholest.box.width()),
        std::log(0.5 * z * wholest.box.height());
    try_at(z, object);
  }
  return best;
}

/// From the frame before to the frame after, if they are close enough to tell. @param window two frames at least
std::optional<Vec6> velocity_at(const std::deque<ObservedFrame>& window, std::size_t frame) {
  constexpr double kMaxSpan_s = 0.4;
  const std::size_t from = frame == 0 ? 0 : frame - 1, to = std::min(frame + 1, window.size() - 1);
  const double span_s = seconds_into(window, to) - seconds_into(window, from);
  if (span_s > kMaxSpan_s) return std::nullopt;
  const SE3 &T_odom_from = window[from].T_odom_camera, &T_odom_to = window[to].T_odom_camera;
  Vec6 motion;
  motion << window[frame].T_odom_camera.q.conjugate() * (T_odom_to.t - T_odom_from.t),
      so3_log(T_odom_from.q.conjugate() * T_odom_to.q);
  return motion / span_s;
}

}  // namespace

double seconds_into(const std::deque<ObservedFrame>& window, std::size_t frame) {
  return 1e-9 * static_cast<double>(window[frame].stamp_ns - window.front().stamp_ns);
}

std::vector<std::size_t> knots_of(const std::deque<ObservedFrame>& window, std::size_t anchor) {
  std::vector<std::size_t> knots;
  for (std::size_t i = 0; i < window.size(); ++i) {
    const bool is_due =
        knots.empty() ||
        1e-9 * static_cast<double>(window[i].stamp_ns - window[knots.back()].stamp_ns) >= kKnotInterval_s;
    if (is_due || i == anchor || i + 1 == window.size()) knots.push_back(i);
  }
  return knots;
}

std::optional<SizedProjection> project(const WindowView& view, const SE3& T_odom_camera, const SizedPoint& object) {
  const Vec3 p = T_odom_camera.q.conjugate() * (object.center - T_odom_camera.t);
  if (p.z() < kMinDepth_m) return std::nullopt;
  SizedProjection projection{p, Vec4::Zero()};
  Vec4 sides;
  sides << p.head<2>() - object.half, p.head<2>() + object.half;
  const Vec4 off = (sides / p.z() - view.box.edges()) / view.sigma;
  for (int side = 0; side < 4; ++side) projection.residual(side) = view.bounds(side) ? off(side) : 0.0;
  return projection;
}

const SE3* WindowSolution::find(std::int64_t stamp_ns) const {
  const auto place = T_odom_camera.find(stamp_ns);
  return place == T_odom_camera.end() ? nullptr : &place->second;
}

WindowProblem::WindowProblem(const std::deque<ObservedFrame>& window, const std::vector<std::size_t>& knots,
                             std::size_t anchor_frame, const Unfollowed& unfollowed, const WindowNoise& window_noise,
                             const WindowSolution& last)
    : noise(window_noise) {
  std::map<std::int64_t, WindowTrack> by_id;
  for (std::size_t k = 0; k < knots.size(); ++k) {
    const ObservedFrame& frame = window[knots[k]];
    if (knots[k] == anchor_frame) anchor = k;
    T_odom_knot.push_back(frame.T_odom_camera);
    velocities.push_back(velocity_at(window, knots[k]));
    times_s.push_back(seconds_into(window, knots[k]));
    for (const ObservedBox& box : frame.boxes) {
      WindowView view{k, box.box, box.truncated, 0.0};
      if (view.cut_sides() > kMaxCutSides) continue;
      view.sigma = noise.box_factor * box_sigma(box.box, frame.focal_px);
      by_id[box.track_id].views.push_back(view);
    }
  }
  for (std::size_t i = 0; i < steps(); ++i) {
    drift_of.push_back(static_cast<std::size_t>(0.5 * (times_s[i] + times_s[i + 1]) / kDriftSpan_s));
  }
  const SE3 T_odom_last = start_knots(window, knots, unfollowed, last);
  for (auto& [id, track] : by_id) {
    if (track.views.size() < kMinWindowViews) continue;
    std::optional<Vec5> known;
    if (const auto place = last.objects.find(id); place != last.objects.end()) {
      known = place->second;
      known->head<3>() = T_odom_last * Vec3(known->head<3>());
    }
    track.id = id;
    track.start = start_of(track.views, start, known);
    tracks.push_back(std::move(track));
  }
}

/// What is known goes on by the odometry, and where that misses something turns by what the boxes move.
/// @return from the world of what is known to this one's
SE3 WindowProblem::start_knots(const std::deque<ObservedFrame>& window, const std::vector<std::size_t>& knots,
                               const Unfollowed& unfollowed, const WindowSolution& last) {
  const std::optional<Slip>& slip = unfollowed.slip;
  start = T_odom_knot;
  missed_s.assign(steps(), 0.0);
  missed_variances.assign(steps(), Vec6::Zero());
  if (const SE3* known = last.find(window.front().stamp_ns)) start.front() = *known;
  for (std::size_t step = 0; step < steps(); ++step) {
    const std::size_t from = knots[step], to = knots[step + 1];
    Quaternion turn = Quaternion::Identity();
    double unseen_s = 0.0;
    for (std::size_t i = from; i < to; ++i) {
      if (!unfollowed.missed[i]) continue;
      const double time_s = seconds_into(window, i + 1) - seconds_into(window, i);
      missed_s[step] += time_s;
      if (unfollowed.bridged[i]) {
        missed_variances[step] += *unfollowed.bridged[i];
      } else {
        unseen_s += time_s;
        turn = turn * turn_by_boxes(window[i], window[i + 1]);
      }
    }
    missed_variances[step] += variances(kUnseenRate * unseen_s, kUnseenRate * unseen_s);
    if (const SE3* known = last.find(window[to].stamp_ns)) {
      start[step + 1] = *known;
    } else if (slip) {
      const SE3 motion = window[slip->from].T_odom_camera.inverse() * window[to].T_odom_camera;
      const double since_s = seconds_into(window, to) - seconds_into(window, slip->from);
      const double share = since_s / (seconds_into(window, slip->to) - seconds_into(window, slip->from));
      start[step + 1] = *last.find(window[slip->from].stamp_ns) * motion *
                        SE3(Quaternion::Identity().slerp(std::min(share, 1.0), slip->turn), Vec3::Zero());
    } else {
      start[step + 1] = start[step] * odometry(step) * SE3(turn, Vec3::Zero());
    }
  }
  const SE3 T_odom_last = T_odom_knot[anchor] * start[anchor].inverse();
  for (SE3& pose : start) pose = T_odom_last * pose;
  return T_odom_last;
}

Vec6 WindowProblem::step_variances(std::size_t step) const {
  return duration_s(step) * variances(noise.odometry.step_m, noise.odometry.step_rad) + missed_variances[step];
}

Vec6 WindowProblem::drift_variances() const { return variances(noise.odometry.drift_mps, noise.odometry.drift_radps); }

}  // namespace semantic_topo_loop::core
