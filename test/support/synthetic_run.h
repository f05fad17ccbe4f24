#pragma once

#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>
#include <vector>

#include "odometry/odometry_edge.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/pose_graph/pose_graph.h"
#include "semantic_topo_loop/pose_graph/pose_graph_options.h"
#include "support/random_motions.h"

namespace semantic_topo_loop::core {

/// A camera that goes round a room of 5 m by 3 m, twice or more often, looking inwards: truth, odometry, frames and
/// loops between the rounds. Every frame is a keyframe.
class SyntheticRun {
 public:
  explicit SyntheticRun(int keyframes_per_round = 100, int rounds = 2) : round_(keyframes_per_round) {
    for (int k = 0; k < rounds * round_; ++k) {
      const double phase = 2.0 * kPi * k / round_;
      const Vec3 t(2.5 * std::cos(phase), 1.5 * std::sin(phase), 0.1 * std::sin(3.0 * phase));
      truth_.emplace_back(so3_exp(Vec3(0.0, 0.0, phase)) * so3_exp(Vec3(0.1 * std::sin(2.0 * phase), 0.05, 0.0)), t);
    }
    odometry_ = truth_;
  }

  int round() const { return round_; }
  int size() const { return static_cast<int>(truth_.size()); }
  const SE3& truth(int k) const { return truth_[static_cast<std::size_t>(k)]; }
  const SE3& odometry(int k) const { return odometry_[static_cast<std::size_t>(k)]; }
  const std::vector<SE3>& odometry() const { return odometry_; }
  /// The odometry between the frames.
  std::vector<OdometryEdge> edges() const {
    std::vector<OdometryEdge> edges;
    OdometryAccumulator accumulator;
    for (int k = 0; k < size(); ++k) {
      accumulator.add(frame(k));
      if (k > 0) edges.push_back(accumulator.finish(odometry(k - 1), odometry(k)));
    }
    return edges;
  }

  /// Odometry whose motions carry noise on the right and, between first and last, a constant motion more.
  void drift(double translation_m, double rotation_rad, std::uint64_t seed, const Vec6& bias = Vec6::Zero(),
             int first = 0, int last = 1 << 30) {
    Random random(seed);
    for (int k = 1; k < size(); ++k) {
      SE3 motion = truth(k - 1).inverse() * truth(k) * random_motion(&random, translation_m, rotation_rad);
      if (k >= first && k < last) motion = motion * se3_exp(bias);
      odometry_[static_cast<std::size_t>(k)] = odometry(k - 1) * motion;
    }
  }
  /// The world in which the odometry counts from frame `first` on is another one.
  void restart(int first, const SE3& T_new_old) {
    for (int k = first; k < size(); ++k) odometry_[static_cast<std::size_t>(k)] = T_new_old * odometry(k);
  }
  /// From now on the odometry counts in a unit of length that grows steadily, to exp(log_scale) times the first.
  void drift_scale(double log_scale) {
    const std::vector<SE3> before = odometry_;
    log_scale_ = log_scale;
    for (int k = 1; k < size(); ++k) {
      const auto i = static_cast<std::size_t>(k);
      SE3 motion = before[i - 1].inverse() * before[i];
      motion.t *= unit(k - 1);
      odometry_[i] = odometry_[i - 1] * motion;
    }
  }
  /// The odometry's unit of length at a frame: so many make a metre.
  double unit(int k) const { return std::exp(log_scale_ * k / size()); }
  /// A loop as one finds it in the odometry's units.
  LoopClosure in_units(LoopClosure closure) const {
    const double unit_match = unit(static_cast<int>(closure.match_frame));
    closure.T_match_query.t *= unit_match;
    closure.covariance.topRows<3>() *= unit_match;
    closure.covariance.leftCols<3>() *= unit_match;
    closure.scale = unit_match / unit(static_cast<int>(closure.query_frame));
    return closure;
  }
  void move_world(const SE3& T) { restart(0, T); }

  Frame frame(int k) const {
    Frame frame;
    frame.frame_id = k;
    frame.stamp_ns = 1000000000LL + 200000000LL * k;
    frame.keyframe_id = k;
    frame.is_keyframe = true;
    frame.T_odom_camera = odometry(k);
    return frame;
  }
  Frame end_frame() const {
    Frame frame = this->frame(size() - 1);
    frame.frame_id = size();
    frame.is_keyframe = false;
    frame.is_end = true;
    return frame;
  }

  /// A loop with the given noise, stated as it is; its evidence windows are `window` frames long and end at the frames.
  LoopClosure loop(int query, int match, const Vec6& noise, double sigma_m, double sigma_rad, int window = 5) const {
    LoopClosure closure;
    closure.query_keyframe_id = closure.query_frame = closure.query_end = query;
    closure.match_keyframe_id = closure.match_frame = closure.match_end = match;
    closure.query_begin = std::max(0, query - window + 1);
    closure.match_begin = std::max(0, match - window + 1);
    closure.accepted = true;
    closure.reason = LoopReason::kAccepted;
    closure.T_match_query = truth(match).inverse() * truth(query) * se3_exp(noise);
    Vec6 variances;
    variances << Vec3::Constant(sigma_m * sigma_m), Vec3::Constant(sigma_rad * sigma_rad);
    closure.covariance = variances.asDiagonal();
    return closure;
  }
  LoopClosure exact_loop(int query, int match) const { return loop(query, match, Vec6::Zero(), 1e-3, 1e-3); }

  /// Largest distance of a keyframe from the truth, in the frame of the first keyframe.
  double worst_error_m(const std::vector<KeyframePose>& keyframes) const {
    const SE3 T_truth_map = truth(0) * keyframes.front().T_map_camera.inverse();
    double worst = 0.0;
    for (const KeyframePose& keyframe : keyframes) {
      const Vec3 t = T_truth_map * keyframe.T_map_camera.t;
      worst = std::max(worst, (t - truth(static_cast<int>(keyframe.frame_id)).t).norm());
    }
    return worst;
  }
  double worst_odometry_error_m() const {
    const SE3 T_truth_odom = truth(0) * odometry(0).inverse();
    double worst = 0.0;
    for (int k = 0; k < size(); ++k) worst = std::max(worst, (T_truth_odom * odometry(k).t - truth(k).t).norm());
    return worst;
  }

 private:
  int round_;
  std::vector<SE3> truth_, odometry_;
  double log_scale_ = 0.0;
};

constexpr double kSigma_m = 0.02, kSigma_rad = 0.01;  ///< of each axis of noisy_loops()

/// Loops from every `step`th keyframe of the second round, with independent noise as stated.
inline std::vector<LoopClosure> noisy_loops(const SyntheticRun& run, std::uint64_t seed, int step = 5) {
  Random random(seed);
  std::vector<LoopClosure> loops;
  for (int k = run.round() + 10; k < run.size(); k += step) {
    loops.push_back(run.loop(k, k - run.round(), random_tangent(&random, kSigma_m, kSigma_rad), kSigma_m, kSigma_rad));
  }
  return loops;
}

/// The loop between the vertices that are its keyframes.
inline GraphLoop graph_loop(const LoopClosure& closure) {
  return *make_graph_loop(closure, static_cast<int>(closure.query_keyframe_id),
                          static_cast<int>(closure.match_keyframe_id));
}

/// Those of which a frame is the query.
inline std::vector<LoopClosure> loops_at(int frame, const std::vector<LoopClosure>& loops) {
  std::vector<LoopClosure> result;
  std::copy_if(loops.begin(), loops.end(), std::back_inserter(result),
               [frame](const LoopClosure& loop) { return loop.query_frame == frame; });
  return result;
}

/// A pose graph that was fed a whole run, and what it said last, with what it said last of every loop.
struct FinishedRun {
  PoseGraph graph;
  MapCorrection end;
  int changes = 0;
};

/// @param loops each is handed over at its query frame
inline FinishedRun finish(const SyntheticRun& run, const std::vector<LoopClosure>& loops,
                          const PoseGraphOptions& options = {}, const std::vector<int>& breaks = {}) {
  FinishedRun finished{PoseGraph(options), {}, 0};
  std::map<std::int64_t, LoopVerdict> verdicts;
  const auto process = [&](const Frame& frame, const std::vector<LoopClosure>& loops_of_frame) {
    finished.end = finished.graph.process(frame, loops_of_frame);
    finished.changes += finished.end.changed ? 1 : 0;
    for (const LoopVerdict& verdict : finished.end.loops) verdicts.insert_or_assign(verdict.number, verdict);
  };
  for (int k = 0; k < run.size(); ++k) {
    Frame frame = run.frame(k);
    frame.is_break = std::find(breaks.begin(), breaks.end(), k) != breaks.end();
    process(frame, loops_at(k, loops));
  }
  process(run.end_frame(), {});
  finished.end.loops.clear();
  for (const auto& [number, verdict] : verdicts) finished.end.loops.push_back(verdict);
  return finished;
}

}  // namespace semantic_topo_loop::core
