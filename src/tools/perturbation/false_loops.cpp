#include "tools/perturbation/false_loops.h"

#include <algorithm>

#include "semantic_topo_loop/geometry/lie.h"
#include "tools/simulation/random.h"

namespace semantic_topo_loop::core {
namespace {

class FalseLoops {
 public:
  FalseLoops(const std::vector<KeyframePose>& keyframes, const FalseLoopOptions& options, std::uint64_t seed,
             KeyframePairs taken)
      : keyframes_(keyframes), options_(options), random_(seed), taken_(std::move(taken)) {}

  std::vector<LoopClosure> make() {
    const int last = static_cast<int>(keyframes_.size()) - 1, gap = std::max(1, options_.min_gap_keyframes);
    if (last < gap) return {};
    constexpr int kAttempts = 20;
    for (int i = 0; i < kAttempts * options_.count && missing() > 0; ++i) {
      const int query = random_.integer(gap, last), match = random_.integer(0, query - gap);
      add_cluster(query, match);
    }
    std::stable_sort(loops_.begin(), loops_.end(),
                     [](const LoopClosure& a, const LoopClosure& b) { return a.query_frame < b.query_frame; });
    return std::move(loops_);
  }

 private:
  int missing() const { return options_.count - static_cast<int>(loops_.size()); }
  const KeyframePose& keyframe(int i) const { return keyframes_[static_cast<std::size_t>(i)]; }
  SE3 motion(int from, int to) const { return keyframe(from).T_map_camera.inverse() * keyframe(to).T_map_camera; }

  /// The members see the same two places: query and match each move on by up to two keyframes.
  void add_cluster(int query, int match) {
    const SE3 T_match_query = motion(match, query) * error();
    const int members = std::min(std::max(1, options_.cluster_size), missing());
    int q = query, m = match;
    for (int i = 0; i < members; ++i) {
      add(q, m, motion(m, match) * T_match_query * motion(query, q));
      constexpr int kMaxStep = 2;
      q = std::min(q + random_.integer(1, kMaxStep), static_cast<int>(keyframes_.size()) - 1);
      m = std::min(m + random_.integer(0, kMaxStep), q - std::max(1, options_.min_gap_keyframes));
    }
  }

  SE3 error() {
    const Vec3 t = options_.distance_m * random_.uniform(1.0, 2.0) * random_.direction();
    constexpr double kMaxAngle_deg = 180.0;
    const double angle_deg = std::min(options_.rotation_deg * random_.uniform(1.0, 2.0), kMaxAngle_deg);
    return {so3_exp(radians(angle_deg) * random_.direction()), t};
  }

  void add(int query_index, int match_index, const SE3& T_match_query) {
    const KeyframePose &query = keyframe(query_index), &match = keyframe(match_index);
    if (!taken_.insert({query.keyframe_id, match.keyframe_id}).second) return;
    LoopClosure loop;
    loop.query_keyframe_id = query.keyframe_id;
    loop.match_keyframe_id = match.keyframe_id;
    loop.query_frame = loop.query_end = query.frame_id;
    loop.match_frame = loop.match_end = match.frame_id;
    loop.query_stamp_ns = query.stamp_ns;
    loop.match_stamp_ns = match.stamp_ns;
    loop.query_begin = std::max<std::int64_t>(0, query.frame_id - options_.window_frames);
    loop.match_begin = std::max<std::int64_t>(0, match.frame_id - options_.window_frames);
    loop.accepted = true;
    loop.reason = LoopReason::kAccepted;
    loop.T_match_query = T_match_query;
    Vec6 sigmas;
    sigmas << Vec3::Constant(options_.sigma_m), Vec3::Constant(radians(options_.sigma_deg));
    loop.covariance = sigmas.cwiseAbs2().asDiagonal();
    loops_.push_back(loop);
  }

  const std::vector<KeyframePose>& keyframes_;
  const FalseLoopOptions& options_;
  Random random_;
  KeyframePairs taken_;
  std::vector<LoopClosure> loops_;
};

}  // namespace

std::vector<LoopClosure> make_false_loops(const std::vector<KeyframePose>& keyframes, const FalseLoopOptions& options,
                                          std::uint64_t seed, KeyframePairs taken) {
  return FalseLoops(keyframes, options, seed, std::move(taken)).make();
}

}  // namespace semantic_topo_loop::core
