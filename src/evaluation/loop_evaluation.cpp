#include "semantic_topo_loop/evaluation/loop_evaluation.h"

#include <algorithm>
#include <cmath>

namespace semantic_topo_loop::core {
namespace {

constexpr std::int64_t kStampTolerance = 5000000;  // ns; far below the time between two images

double view_angle_deg(const SE3& a, const SE3& b) {
  const double cosine = (a.q * Vec3::UnitZ()).dot(b.q * Vec3::UnitZ());
  return degrees(std::acos(std::clamp(cosine, -1.0, 1.0)));
}

/// The true poses, by number of image.
class Truth {
 public:
  Truth(const StampedPoses& poses, const StampedPoses& mocap, const LoopEvaluationOptions& options)
      : poses_(poses), options_(options) {
    std::vector<std::int64_t> periods;
    for (std::size_t i = 1; i < poses.size(); ++i) periods.push_back(poses[i].stamp_ns - poses[i - 1].stamp_ns);
    std::sort(periods.begin(), periods.end());
    min_gap_ns_ = options.min_gap_frames * (periods.empty() ? 0 : periods[periods.size() / 2]);
    for (const StampedPose& pose : poses) in_hole_.push_back(is_hole(pose.stamp_ns, mocap));
  }

  int size() const { return static_cast<int>(poses_.size()); }
  std::int64_t stamp_ns(int i) const { return poses_[static_cast<std::size_t>(i)].stamp_ns; }
  const SE3& pose(int i) const { return poses_[static_cast<std::size_t>(i)].T_world_camera; }
  bool in_hole(int i) const { return in_hole_[static_cast<std::size_t>(i)]; }

  /// Number of the image of a stamp, or -1.
  int find(std::int64_t stamp_ns) const {
    const StampedPose* found = find_stamp(poses_, stamp_ns, kStampTolerance);
    return found == nullptr ? -1 : static_cast<int>(found - poses_.data());
  }

  bool over_gap(int query, int match) const { return stamp_ns(query) - stamp_ns(match) > min_gap_ns_; }

  /// True if the query sees, much later, a place that the match saw.
  bool is_revisit(int query, int match) const {
    return over_gap(query, match) && !in_hole(query) && !in_hole(match) &&
           (pose(query).t - pose(match).t).norm() < options_.max_distance_m &&
           view_angle_deg(pose(query), pose(match)) < options_.max_view_angle_deg;
  }

  bool is_loopable(int query) const {
    for (int match = 0; match < query; ++match) {
      if (is_revisit(query, match)) return true;
    }
    return false;
  }

 private:
  bool is_hole(std::int64_t stamp_ns, const StampedPoses& mocap) const {
    if (mocap.empty()) return false;
    const auto after = std::lower_bound(mocap.begin(), mocap.end(), stamp_ns,
                                        [](const StampedPose& pose, std::int64_t ns) { return pose.stamp_ns < ns; });
    if (after == mocap.end()) return true;
    if (after->stamp_ns == stamp_ns) return false;
    if (after == mocap.begin()) return true;
    return static_cast<double>(after->stamp_ns - std::prev(after)->stamp_ns) > 1e9 * options_.max_mocap_gap_s;
  }

  const StampedPoses& poses_;
  const LoopEvaluationOptions& options_;
  std::int64_t min_gap_ns_ = 0;
  std::vector<bool> in_hole_;
};

/// An accepted loop with numbers of true images in place of the run's frames.
struct JudgedLoop {
  int query = -1, match = -1;
  std::int64_t query_begin_ns = 0, query_end_ns = 0, match_begin_ns = 0, match_end_ns = 0;
  int query_end = -1;
  double error_m = 0.0, error_deg = 0.0;

  bool holds_query(std::int64_t ns) const { return query_begin_ns <= ns && ns <= query_end_ns; }
  bool holds_match(std::int64_t ns) const { return match_begin_ns <= ns && ns <= match_end_ns; }
};

bool check_frames(const LoopRecord& loop, const StampedPoses& frames, std::string* error) {
  for (const std::int64_t frame :
       {loop.query_frame, loop.match_frame, loop.query_begin, loop.query_end, loop.match_begin, loop.match_end}) {
    if (frame >= 0 && frame < static_cast<std::int64_t>(frames.size())) continue;
    *error = "a loop names frame " + std::to_string(frame) + ", but the run has " + std::to_string(frames.size());
    return false;
  }
  const auto stamp = [&frames](std::int64_t frame) { return frames[static_cast<std::size_t>(frame)].stamp_ns; };
  if (stamp(loop.query_frame) == loop.query_stamp_ns && stamp(loop.match_frame) == loop.match_stamp_ns) return true;
  *error = "the stamps of loop " + std::to_string(loop.query_frame) + " - " + std::to_string(loop.match_frame) +
           " are not those of the run's trajectory";
  return false;
}

/// Number of the true image nearest to a stamp; the truth must not be empty.
int nearest_image(const Truth& truth, std::int64_t stamp_ns) {
  int best = 0;
  for (int i = 1; i < truth.size(); ++i) {
    if (std::abs(truth.stamp_ns(i) - stamp_ns) < std::abs(truth.stamp_ns(best) - stamp_ns)) best = i;
  }
  return best;
}

/// @return nullopt if an end has no true pose or a poor one
std::optional<JudgedLoop> judge(const LoopRecord& loop, const StampedPoses& frames, const Truth& truth) {
  JudgedLoop judged;
  judged.query = truth.find(loop.query_stamp_ns);
  judged.match = truth.find(loop.match_stamp_ns);
  if (judged.query < 0 || judged.match < 0 || truth.in_hole(judged.query) || truth.in_hole(judged.match)) {
    return std::nullopt;
  }
  const auto stamp = [&frames](std::int64_t frame) { return frames[static_cast<std::size_t>(frame)].stamp_ns; };
  judged.query_begin_ns = stamp(loop.query_begin);
  judged.query_end_ns = stamp(loop.query_end);
  judged.match_begin_ns = stamp(loop.match_begin);
  judged.match_end_ns = stamp(loop.match_end);
  judged.query_end = nearest_image(truth, judged.query_end_ns);
  const SE3 T_match_query = truth.pose(judged.match).inverse() * truth.pose(judged.query);
  judged.error_m = (loop.T_match_query.t - T_match_query.t).norm();
  judged.error_deg = degrees(rotation_angle(loop.T_match_query.q, T_match_query.q));
  return judged;
}

void judge_errors(const std::vector<JudgedLoop>& loops, const LoopEvaluationOptions& options, LoopEvaluation* result) {
  std::vector<double> errors_m, errors_deg;
  for (const JudgedLoop& loop : loops) {
    errors_m.push_back(loop.error_m);
    errors_deg.push_back(loop.error_deg);
    result->right_wide.right += loop.error_m <= options.wide_m && loop.error_deg <= options.wide_deg ? 1 : 0;
    result->right_narrow.right += loop.error_m <= options.narrow_m && loop.error_deg <= options.narrow_deg ? 1 : 0;
  }
  result->right_wide.total = result->right_narrow.total = static_cast<int>(loops.size());
  result->error_m = error_statistics(std::move(errors_m));
  result->error_deg = error_statistics(std::move(errors_deg));
}

/// @param loops those over the gap
void judge_queries(const std::vector<JudgedLoop>& loops, const Truth& truth, const LoopEvaluationOptions& options,
                   LoopEvaluation* result) {
  for (int query = 0; query < truth.size(); query += options.query_stride_frames) {
    if (!truth.is_loopable(query)) continue;
    ++result->loopable;
    bool closed = false, at_once = false;
    for (const JudgedLoop& loop : loops) {
      if (loop.error_m > options.wide_m || loop.error_deg > options.wide_deg ||
          !loop.holds_query(truth.stamp_ns(query))) {
        continue;
      }
      closed = true;
      at_once = at_once || loop.query_end <= query + options.at_once_frames;
    }
    result->closed += closed ? 1 : 0;
    result->closed_at_once += at_once ? 1 : 0;
  }
}

/// @param loops those over the gap
void judge_pairs(const std::vector<JudgedLoop>& loops, const Truth& truth, const LoopEvaluationOptions& options,
                 LoopEvaluation* result) {
  for (const JudgedLoop& loop : loops) {
    result->pair_precision.right += truth.is_revisit(loop.query, loop.match) ? 1 : 0;
  }
  result->pair_precision.total = static_cast<int>(loops.size());
  for (int query = 0; query < truth.size(); query += options.query_stride_frames) {
    for (int match = 0; match < query; match += options.query_stride_frames) {
      if (!truth.is_revisit(query, match)) continue;
      ++result->pair_recall.total;
      result->pair_recall.right += std::any_of(loops.begin(), loops.end(), [&](const JudgedLoop& loop) {
        return loop.holds_query(truth.stamp_ns(query)) && loop.holds_match(truth.stamp_ns(match));
      });
    }
  }
}

}  // namespace

std::optional<LoopEvaluation> evaluate_loops(const std::vector<LoopRecord>& loops, const StampedPoses& frames,
                                             const StampedPoses& truth_poses, const StampedPoses& mocap,
                                             const LoopEvaluationOptions& options, std::string* error) {
  const Truth truth(truth_poses, mocap, options);
  std::string problem;
  if (std::none_of(frames.begin(), frames.end(), [&](const StampedPose& f) { return truth.find(f.stamp_ns) >= 0; })) {
    problem = "the run and the true poses have no stamp in common";
  }
  LoopEvaluation result;
  std::vector<JudgedLoop> judged, over_gap;
  for (std::size_t i = 0; i < loops.size() && problem.empty(); ++i) {
    ++result.candidates;
    if (!check_frames(loops[i], frames, &problem) || !loops[i].accepted) continue;
    ++result.accepted;
    if (const std::optional<JudgedLoop> loop = judge(loops[i], frames, truth)) {
      judged.push_back(*loop);
      if (truth.over_gap(loop->query, loop->match)) over_gap.push_back(*loop);
    } else {
      ++result.not_judged;
    }
  }
  if (!problem.empty()) {
    if (error != nullptr) *error = problem;
    return std::nullopt;
  }
  judge_errors(judged, options, &result);
  judge_queries(over_gap, truth, options, &result);
  judge_pairs(over_gap, truth, options, &result);
  return result;
}

}  // namespace semantic_topo_loop::core
