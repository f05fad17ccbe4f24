#include "tools/evaluation/loop_evaluation.h"

#include <algorithm>
#include <cmath>
#include <iterator>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::int64_t kStampTolerance = 5000000;  // ns; far below the time between two images

bool is_hole(std::int64_t stamp_ns, const StampedPoses& mocap, double max_gap_s) {
  if (mocap.empty()) return false;
  const auto after = std::lower_bound(mocap.begin(), mocap.end(), stamp_ns,
                                      [](const StampedPose& pose, std::int64_t ns) { return pose.stamp_ns < ns; });
  if (after == mocap.end()) return true;
  if (after->stamp_ns == stamp_ns) return false;
  if (after == mocap.begin()) return true;
  return static_cast<double>(after->stamp_ns - std::prev(after)->stamp_ns) > 1e9 * max_gap_s;
}

/// The poses of a run's frames, by frame_id.
class RunFrames {
 public:
  RunFrames(const StampedPoses& poses, std::int64_t first_frame) : poses_(poses), first_(first_frame) {}

  bool is_earlier(std::int64_t frame) const { return frame >= 0 && frame < first_; }
  bool has(std::int64_t frame) const {
    return frame >= first_ && frame - first_ < static_cast<std::int64_t>(poses_.size());
  }
  std::int64_t stamp_ns(std::int64_t frame) const { return poses_[static_cast<std::size_t>(frame - first_)].stamp_ns; }
  std::size_t size() const { return poses_.size(); }

 private:
  const StampedPoses& poses_;
  const std::int64_t first_;
};

Status check_frames(const LoopRecord& loop, const RunFrames& frames) {
  for (const std::int64_t frame :
       {loop.query_frame, loop.match_frame, loop.query_begin, loop.query_end, loop.match_begin, loop.match_end}) {
    if (frames.has(frame)) continue;
    return Error{"a loop names frame " + std::to_string(frame) + ", which the run does not have"};
  }
  if (frames.stamp_ns(loop.query_frame) == loop.query_stamp_ns &&
      frames.stamp_ns(loop.match_frame) == loop.match_stamp_ns) {
    return {};
  }
  return Error{"the stamps of loop " + std::to_string(loop.query_frame) + " - " + std::to_string(loop.match_frame) +
               " are not those of the run's trajectory"};
}

bool has_pose(const LoopRecord& loop) {
  return loop.T_match_query.t != Vec3::Zero() || loop.T_match_query.q.vec() != Vec3::Zero();
}

JudgedLoop judge(const LoopRecord& loop, const RunFrames& frames, const TruePoses& truth) {
  JudgedLoop judged;
  judged.record = loop;
  judged.query = truth.find(loop.query_stamp_ns);
  judged.match = truth.find(loop.match_stamp_ns);
  judged.query_begin_ns = frames.stamp_ns(loop.query_begin);
  judged.query_end_ns = frames.stamp_ns(loop.query_end);
  judged.match_begin_ns = frames.stamp_ns(loop.match_begin);
  judged.match_end_ns = frames.stamp_ns(loop.match_end);
  judged.query_end = truth.nearest(judged.query_end_ns);
  judged.is_judged =
      judged.query >= 0 && judged.match >= 0 && !truth.in_hole(judged.query) && !truth.in_hole(judged.match);
  if (!judged.is_judged) return judged;
  const SE3 T_match_query = truth.pose(judged.match).inverse() * truth.pose(judged.query);
  const double unknown = std::numeric_limits<double>::infinity();
  judged.error_m = has_pose(loop) ? (loop.T_match_query.t - T_match_query.t).norm() : unknown;
  judged.error_deg = has_pose(loop) ? degrees(rotation_angle(loop.T_match_query.q, T_match_query.q)) : unknown;
  judged.distance_m = truth.distance_m(judged.query, judged.match);
  judged.axes_deg = truth.axes_angle_deg(judged.query, judged.match);
  judged.view_deg = degrees(rotation_angle(T_match_query.q, Quaternion::Identity()));
  return judged;
}

}  // namespace

TruePoses::TruePoses(StampedPoses poses, const StampedPoses& mocap, double max_mocap_gap_s) : poses_(std::move(poses)) {
  std::vector<std::int64_t> periods;
  for (std::size_t i = 1; i < poses_.size(); ++i) periods.push_back(poses_[i].stamp_ns - poses_[i - 1].stamp_ns);
  std::sort(periods.begin(), periods.end());
  period_ns_ = periods.empty() ? 0 : periods[periods.size() / 2];
  for (const StampedPose& pose : poses_) in_hole_.push_back(is_hole(pose.stamp_ns, mocap, max_mocap_gap_s));
}

int TruePoses::find(std::int64_t stamp_ns) const {
  const StampedPose* found = find_stamp(poses_, stamp_ns, kStampTolerance);
  return found == nullptr ? -1 : static_cast<int>(found - poses_.data());
}

int TruePoses::nearest(std::int64_t stamp_ns) const {
  const StampedPose* found = find_stamp(poses_, stamp_ns, std::numeric_limits<std::int64_t>::max());
  return static_cast<int>(found - poses_.data());
}

double TruePoses::axes_angle_deg(int a, int b) const {
  const double cosine = (pose(a).q * Vec3::UnitZ()).dot(pose(b).q * Vec3::UnitZ());
  return degrees(std::acos(std::clamp(cosine, -1.0, 1.0)));
}

bool TruePoses::is_revisit(int query, int match, const RevisitCriterion& criterion) const {
  if (!over_gap(query, match, criterion.min_gap_frames)) return false;
  if (!criterion.needs_poses()) return true;
  return !in_hole(query) && !in_hole(match) && distance_m(query, match) < criterion.max_distance_m &&
         axes_angle_deg(query, match) < criterion.max_view_angle_deg;
}

bool TruePoses::is_loopable(int query, const RevisitCriterion& criterion) const {
  for (int match = 0; match < query; ++match) {
    if (is_revisit(query, match, criterion)) return true;
  }
  return false;
}

std::int64_t first_frame_id(const std::vector<KeyframePose>& keyframes) {
  return keyframes.empty() ? 0 : std::max<std::int64_t>(0, keyframes.front().frame_id);
}

Result<std::vector<JudgedLoop>> judge_loops(const std::vector<LoopRecord>& loops, const StampedPoses& frames,
                                            const TruePoses& truth, std::int64_t first_frame) {
  const RunFrames run(frames, first_frame);
  if (std::none_of(frames.begin(), frames.end(), [&](const StampedPose& f) { return truth.find(f.stamp_ns) >= 0; })) {
    return Error{"the run and the true poses have no stamp in common"};
  }
  std::vector<JudgedLoop> judged;
  for (const LoopRecord& loop : loops) {
    if (run.has(loop.query_frame) && run.is_earlier(loop.match_frame)) continue;
    if (const Status checked = check_frames(loop, run); !checked) return checked.error();
    judged.push_back(judge(loop, run, truth));
  }
  return judged;
}

namespace {

using JudgedLoops = std::vector<const JudgedLoop*>;

LoopErrors figures_of(const JudgedLoops& loops) {
  LoopErrors figures;
  std::vector<double> errors_m, errors_deg;
  for (const JudgedLoop* loop : loops) {
    errors_m.push_back(loop->error_m);
    errors_deg.push_back(loop->error_deg);
    figures.right_wide.right += loop->is_right() ? 1 : 0;
    figures.right_narrow.right += loop->is_right(kLoopLimits.narrow_m, kLoopLimits.narrow_deg) ? 1 : 0;
  }
  figures.right_wide.total = figures.right_narrow.total = static_cast<int>(loops.size());
  figures.error_m = error_statistics(std::move(errors_m));
  figures.error_deg = error_statistics(std::move(errors_deg));
  return figures;
}

void judge_viewpoints(const JudgedLoops& loops, LoopEvaluation* result) {
  constexpr double kBinDeg = 180.0 / kViewpointBins;
  std::array<JudgedLoops, kViewpointBins> bins;
  for (const JudgedLoop* loop : loops) {
    bins[std::min<std::size_t>(static_cast<std::size_t>(loop->view_deg / kBinDeg), kViewpointBins - 1)].push_back(loop);
    if (loop->is_right()) {
      result->largest_right_view_deg = std::max(result->largest_right_view_deg, loop->view_deg);
    }
  }
  for (std::size_t i = 0; i < bins.size(); ++i) {
    result->by_viewpoint[i] = {figures_of(bins[i]), static_cast<double>(i) * kBinDeg,
                               static_cast<double>(i + 1) * kBinDeg};
  }
}

std::optional<int> latency_frames(const Revisit& revisit, const JudgedLoops& loops) {
  std::optional<int> latency;
  for (const JudgedLoop* loop : loops) {
    if (!loop->is_right() || loop->query_end < revisit.first || loop->query_end > revisit.last) continue;
    latency = std::min(latency.value_or(loop->query_end - revisit.first), loop->query_end - revisit.first);
  }
  return latency;
}

/// @param loops those over the gap
void judge_queries(const JudgedLoops& loops, const TruePoses& truth, LoopEvaluation* result) {
  bool is_open = false;
  for (int query = 0; query < truth.size(); query += kLoopLimits.query_stride_frames) {
    if (!truth.is_loopable(query, kLoopLimits.revisit)) {
      is_open = is_open && truth.in_hole(query);
      continue;
    }
    ++result->loopable;
    bool closed = false, at_once = false;
    for (const JudgedLoop* loop : loops) {
      if (!loop->is_right() || !loop->holds_query(truth.stamp_ns(query))) continue;
      closed = true;
      at_once = at_once || loop->query_end <= query + kLoopLimits.at_once_frames;
    }
    result->closed += closed ? 1 : 0;
    result->closed_at_once += at_once ? 1 : 0;
    if (!is_open) result->revisits.push_back({query, query, std::nullopt});
    result->revisits.back().last = query;
    is_open = true;
  }
  for (Revisit& revisit : result->revisits) revisit.latency_frames = latency_frames(revisit, loops);
}

/// @param loops those over the gap
void judge_pairs(const JudgedLoops& loops, const TruePoses& truth, LoopEvaluation* result) {
  for (const JudgedLoop* loop : loops) {
    result->pair_precision.right += truth.is_revisit(loop->query, loop->match, kLoopLimits.revisit) ? 1 : 0;
  }
  result->pair_precision.total = static_cast<int>(loops.size());
  for (int query = 0; query < truth.size(); query += kLoopLimits.query_stride_frames) {
    JudgedLoops holding;
    std::copy_if(loops.begin(), loops.end(), std::back_inserter(holding),
                 [&](const JudgedLoop* loop) { return loop->holds_query(truth.stamp_ns(query)); });
    for (int match = 0; match < query; match += kLoopLimits.query_stride_frames) {
      if (!truth.is_revisit(query, match, kLoopLimits.revisit)) continue;
      ++result->pair_recall.total;
      result->pair_recall.right += std::any_of(holding.begin(), holding.end(), [&](const JudgedLoop* loop) {
        return loop->holds_match(truth.stamp_ns(match));
      });
    }
  }
}

}  // namespace

LoopEvaluation evaluate_loops(const std::vector<JudgedLoop>& loops, const TruePoses& truth) {
  LoopEvaluation result;
  JudgedLoops accepted, over_gap;
  for (const JudgedLoop& loop : loops) {
    ++result.candidates;
    if (!loop.record.accepted) continue;
    ++result.accepted;
    if (!loop.is_judged) {
      ++result.not_judged;
      continue;
    }
    accepted.push_back(&loop);
    if (truth.over_gap(loop.query, loop.match, kLoopLimits.revisit.min_gap_frames)) over_gap.push_back(&loop);
  }
  static_cast<LoopErrors&>(result) = figures_of(accepted);
  judge_viewpoints(accepted, &result);
  judge_queries(over_gap, truth, &result);
  judge_pairs(over_gap, truth, &result);
  return result;
}

}  // namespace semantic_topo_loop::core
