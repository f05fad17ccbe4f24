#include "tools/perturbation/perturbation.h"

#include <algorithm>

#include "semantic_topo_loop/geometry/lie.h"
#include "tools/simulation/random.h"

namespace semantic_topo_loop::core {
namespace {

/// The random numbers of one box, all drawn whether they are needed or not.
struct Draws {
  explicit Draws(Random* random) : drop(random->uniform()), relabel(random->uniform()), other_class(random->uniform()) {
    for (int i = 0; i < 4; ++i) edges[i] = random->normal();
  }
  double drop, relabel, other_class;
  Vec4 edges;
};

std::vector<int> classes_of(const std::vector<DetectionFrame>& frames) {
  std::set<int> ids;
  for (const DetectionFrame& frame : frames) {
    for (const Detection& detection : frame.detections) ids.insert(detection.class_id);
  }
  return {ids.begin(), ids.end()};
}

/// Uniform over the others of two or more classes. @param draw in [0, 1)
int another_class(int class_id, const std::vector<int>& classes, double draw) {
  const auto index = static_cast<std::size_t>(draw * static_cast<double>(classes.size() - 1));
  return classes[index] < class_id ? classes[index] : classes[index + 1];
}

Box jittered(const Box& box, const Vec4& errors, double sigma) {
  const double x1 = box.x1 + sigma * box.width() * errors[0], y1 = box.y1 + sigma * box.height() * errors[1];
  const double x2 = box.x2 + sigma * box.width() * errors[2], y2 = box.y2 + sigma * box.height() * errors[3];
  return {std::min(x1, x2), std::min(y1, y2), std::max(x1, x2), std::max(y1, y2)};
}

struct FalseLoops {
  const std::vector<KeyframePose>& keyframes;
  const FalseLoopOptions& options;
  Random random;
  KeyframePairs taken;
  std::vector<LoopClosure> loops = {};

  std::vector<LoopClosure> make() {
    const int last = static_cast<int>(keyframes.size()) - 1, gap = std::max(1, options.min_gap_keyframes);
    if (last < gap) return {};
    constexpr int kAttempts = 20;  // a loop: most pairs are free unless nearly all are taken
    for (int i = 0; i < kAttempts * options.count && missing() > 0; ++i) {
      const int query = random.integer(gap, last), match = random.integer(0, query - gap);
      add_cluster(query, match);
    }
    std::stable_sort(loops.begin(), loops.end(),
                     [](const LoopClosure& a, const LoopClosure& b) { return a.query_frame < b.query_frame; });
    return std::move(loops);
  }

  int missing() const { return options.count - static_cast<int>(loops.size()); }
  const KeyframePose& keyframe(int i) const { return keyframes[static_cast<std::size_t>(i)]; }
  SE3 motion(int from, int to) const { return keyframe(from).T_map_camera.inverse() * keyframe(to).T_map_camera; }

  /// The members see the same two places: query and match each move on by up to two keyframes.
  void add_cluster(int query, int match) {
    const SE3 T_match_query = motion(match, query) * error();
    const int members = std::min(std::max(1, options.cluster_size), missing());
    int q = query, m = match;
    for (int i = 0; i < members; ++i) {
      add(q, m, motion(m, match) * T_match_query * motion(query, q));
      constexpr int kMaxStep = 2;  // keyframes: neighbouring, as a place seen for a while gives them
      q = std::min(q + random.integer(1, kMaxStep), static_cast<int>(keyframes.size()) - 1);
      m = std::min(m + random.integer(0, kMaxStep), q - std::max(1, options.min_gap_keyframes));
    }
  }

  SE3 error() {
    const Vec3 t = options.distance_m * random.uniform(1.0, 2.0) * random.direction();
    constexpr double kMaxAngle_deg = 180.0;  // beyond, the rotation is less again
    const double angle_deg = std::min(options.rotation_deg * random.uniform(1.0, 2.0), kMaxAngle_deg);
    return {so3_exp(radians(angle_deg) * random.direction()), t};
  }

  void add(int query_index, int match_index, const SE3& T_match_query) {
    const KeyframePose &query = keyframe(query_index), &match = keyframe(match_index);
    if (!taken.insert({query.keyframe_id, match.keyframe_id}).second) return;
    LoopClosure loop;
    loop.query_keyframe_id = query.keyframe_id;
    loop.match_keyframe_id = match.keyframe_id;
    loop.query_frame = loop.query_end = query.frame_id;
    loop.match_frame = loop.match_end = match.frame_id;
    loop.query_stamp_ns = query.stamp_ns;
    loop.match_stamp_ns = match.stamp_ns;
    loop.query_begin = std::max<std::int64_t>(0, query.frame_id - options.window_frames);
    loop.match_begin = std::max<std::int64_t>(0, match.frame_id - options.window_frames);
    loop.accepted = true;
    loop.reason = LoopReason::kAccepted;
    loop.T_match_query = T_match_query;
    Vec6 sigmas;
    sigmas << Vec3::Constant(options.sigma_m), Vec3::Constant(radians(options.sigma_deg));
    loop.covariance = sigmas.cwiseAbs2().asDiagonal();
    loops.push_back(loop);
  }
};

}  // namespace

std::vector<DetectionFrame> perturb_detections(const std::vector<DetectionFrame>& frames,
                                               const PerturbationOptions& options, std::uint64_t seed,
                                               PerturbationCounts* counts) {
  const std::vector<int> classes = classes_of(frames);
  Random random(seed);
  std::vector<DetectionFrame> result;
  result.reserve(frames.size());
  for (const DetectionFrame& frame : frames) {
    result.push_back({frame.stamp_ns, {}});
    for (Detection detection : frame.detections) {
      const Draws draws(&random);
      ++counts->boxes;
      if (draws.drop < options.drop) {
        ++counts->dropped;
        continue;
      }
      if (draws.relabel < options.relabel && classes.size() > 1) {
        ++counts->relabelled;
        detection.class_id = another_class(detection.class_id, classes, draws.other_class);
      }
      detection.box = jittered(detection.box, draws.edges, options.jitter);
      result.back().detections.push_back(detection);
    }
  }
  return result;
}

std::vector<LoopClosure> make_false_loops(const std::vector<KeyframePose>& keyframes, const FalseLoopOptions& options,
                                          std::uint64_t seed, KeyframePairs taken) {
  return FalseLoops{keyframes, options, Random(seed), std::move(taken)}.make();
}

}  // namespace semantic_topo_loop::core
