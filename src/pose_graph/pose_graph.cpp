#include "semantic_topo_loop/pose_graph/pose_graph.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <iomanip>
#include <map>
#include <optional>
#include <sstream>
#include <string>
#include <utility>

#include "odometry/motion_bursts.h"
#include "pose_graph/rejection/loop_clusters.h"
#include "pose_graph/rejection/loop_consistency.h"
#include "pose_graph/scale/scaled_trajectory.h"
#include "pose_graph/solver/object_memory.h"
#include "pose_graph/solver/trajectory_optimizer.h"

namespace semantic_topo_loop::core {

class PoseGraph::Impl {
 public:
  explicit Impl(const PoseGraphOptions& options) : options_(options) {
    knowledge_.noise.odometry = noise_prior(options_).least;
    has_objects_ = options_.objects != "off" && !has_free_scale();
    trajectory_.objects.noise = {options_.object_weight, options_.object_sigma_px, options_.object_sigma_share};
  }

  void observe(const Frame& frame, const AssociationFrame& associations) {
    if (has_objects_ && is_vertex(frame)) objects_.add(static_cast<int>(keyframes_.size()), frame, associations);
  }

  void apply(const MapUpdate& update) {
    if (has_objects_) objects_.apply(update, vertex_of_, trajectory_.T_map_vertex);
  }

  MapCorrection process(const Frame& frame, const std::vector<LoopClosure>& loops,
                        const std::vector<LoopClosure>& extra_loops) {
    MapCorrection correction;
    correction.frame_id = frame.frame_id;
    correction.T_map_odom_old = T_map_odom_;
    if (!frame.is_end) add_frame(frame);
    for (const LoopClosure& loop : loops) add_loop(loop, false);
    for (const LoopClosure& loop : extra_loops) add_loop(loop, true);
    if (is_due(frame)) {
      const auto start = std::chrono::steady_clock::now();
      correction.changed = optimize(frame.is_end);
      correction.duration_us =
          std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - start).count();
    }
    if (has_free_scale()) T_map_odom_ = place(T_odom_frame_) * T_odom_frame_.inverse();
    correction.T_map_odom = T_map_odom_;
    correction.scale = log_scale_.empty() ? 1.0 : std::exp(log_scale_.back());
    if (!keyframes_.empty()) correction.valid_to_keyframe_id = keyframes_.back().keyframe_id;
    if (correction.changed) {
      correction.keyframes = keyframes();
      correction.loops = verdicts();
      correction.odometry = odometry_report();
    }
    return correction;
  }

  bool withdraw(std::int64_t query_keyframe_id, std::int64_t match_keyframe_id) {
    const auto is_meant = [=](const Entry& entry) {
      return entry.query_keyframe_id == query_keyframe_id && entry.match_keyframe_id == match_keyframe_id;
    };
    if (std::none_of(entries_.begin(), entries_.end(), is_meant)) return false;
    std::vector<Entry> rest;
    std::vector<GraphLoop> loops;
    std::vector<bool> kept;
    for (Entry& entry : entries_) {
      if (is_meant(entry)) continue;
      if (entry.index >= 0) {
        kept.push_back(knowledge_.kept[static_cast<std::size_t>(entry.index)]);
        entry.index = static_cast<int>(loops.size());
        loops.push_back(*entry.loop);
      }
      rest.push_back(std::move(entry));
    }
    is_withdrawn_ = loops.size() < trajectory_.loops.size() || is_withdrawn_;
    entries_ = std::move(rest);
    trajectory_.loops = std::move(loops);
    knowledge_.kept = std::move(kept);
    consistency_.clear();
    return true;
  }

  const SE3& T_map_odom() const { return T_map_odom_; }

  std::vector<KeyframePose> keyframes() const {
    std::vector<KeyframePose> poses = keyframes_;
    for (std::size_t i = 0; i < poses.size(); ++i) {
      poses[i].T_map_camera = trajectory_.T_map_vertex[i];
      poses[i].scale = std::exp(log_scale_[i]);
    }
    return poses;
  }

 private:
  /// Whether the frame, which is not in the graph yet, becomes a vertex of it.
  bool is_vertex(const Frame& frame) const {
    return frame.is_keyframe && frame.T_odom_camera.is_finite() && vertex_of_.count(frame.keyframe_id) == 0;
  }

  bool has_free_scale() const { return options_.scale == "free"; }

  /// Where a camera behind the last keyframe is in the map.
  SE3 place(const SE3& T_odom_camera) const {
    if (!has_free_scale() || keyframes_.empty()) return T_map_odom_ * T_odom_camera;
    const Sim3 S_map_keyframe(trajectory_.T_map_vertex.back(), std::exp(log_scale_.back()));
    return S_map_keyframe.pose(T_odom_keyframe_.inverse() * T_odom_camera);
  }

  void add_frame(const Frame& frame) {
    if (!frame.T_odom_camera.is_finite()) return;
    bursts_.push({frame.stamp_ns, frame.T_odom_camera}, frame.is_break, keyframes_.empty() ? 0 : keyframes_.size() - 1);
    accumulator_.add(frame);
    T_odom_frame_ = frame.T_odom_camera;
    if (!is_vertex(frame)) return;
    if (!keyframes_.empty()) trajectory_.edges.push_back(accumulator_.finish(T_odom_keyframe_, frame.T_odom_camera));
    vertex_of_[frame.keyframe_id] = static_cast<int>(keyframes_.size());
    trajectory_.T_map_vertex.push_back(place(frame.T_odom_camera));
    log_scale_.push_back(log_scale_.empty() ? 0.0 : log_scale_.back());
    keyframes_.push_back({frame.keyframe_id, frame.frame_id, frame.stamp_ns, SE3()});
    T_odom_keyframe_ = frame.T_odom_camera;
    q_camera_odom_.push_back(T_odom_keyframe_.q.conjugate());
    ++keyframes_since_;
  }

  /// A loop that the detector accepted.
  struct Entry {
    std::int64_t query_keyframe_id = -1, match_keyframe_id = -1;
    std::optional<GraphLoop> loop;  ///< none if it was refused
    std::string refusal;
    int index = -1;         ///< in the graph; -1 for loops that repeat others
    bool is_extra = false;  ///< given from outside
  };

  void add_loop(const LoopClosure& closure, bool is_extra) {
    if (!closure.accepted) return;
    Entry entry;
    entry.is_extra = is_extra;
    entry.query_keyframe_id = closure.query_keyframe_id;
    entry.match_keyframe_id = closure.match_keyframe_id;
    entry.loop =
        make_graph_loop(closure, vertex(closure.query_keyframe_id), vertex(closure.match_keyframe_id), &entry.refusal);
    if (entry.loop && !is_repetition(*entry.loop)) {
      entry.index = static_cast<int>(trajectory_.loops.size());
      trajectory_.loops.push_back(*entry.loop);
      knowledge_.kept.push_back(true);
      const double disagreement = chi2(*entry.loop);
      has_new_loops_ = true;
      is_upset_ = is_upset_ || disagreement > options_.robust_chi2;
      is_urgent_ = is_urgent_ || disagreement > options_.urgent_chi2;
    }
    entries_.push_back(std::move(entry));
  }

  /// Whether the graph has the evidence of a loop often enough, in loops that are believed. The more of them it holds
  /// the sooner it has, so that the time of a solve hardly grows.
  bool is_repetition(const GraphLoop& loop) const {
    constexpr double kMany = 400.0;
    double sum = 0.0, loops = 0.0;
    for (std::size_t k = 0; k < trajectory_.loops.size(); ++k) {
      if (!knowledge_.kept[k]) continue;
      const double shared = shared_evidence(loop, trajectory_.loops[k]);
      constexpr double kCopy = 0.99;
      if (shared > kCopy) return true;
      sum += shared;
      loops += 1.0;
    }
    return sum >= options_.max_redundancy * std::min(1.0, kMany / std::max(loops, 1.0));
  }

  double chi2(const GraphLoop& loop) const {
    if (has_free_scale()) return chi_squared(loop, trajectory_.T_map_vertex, log_scale_);
    return chi_squared(loop, trajectory_.T_map_vertex);
  }

  int vertex(std::int64_t keyframe_id) const {
    const auto found = vertex_of_.find(keyframe_id);
    return found == vertex_of_.end() ? -1 : found->second;
  }

  /// Loops that the map agrees with can wait longer.
  bool is_due(const Frame& frame) const {
    if (is_withdrawn_) return true;
    if (frame.is_end && options_.objects == "on" && !objects_.empty()) return true;
    if (trajectory_.loops.empty()) return false;
    if (frame.is_end) return true;
    constexpr int kPatience = 4;
    const int interval = is_upset_ ? options_.interval_keyframes : kPatience * options_.interval_keyframes;
    return has_new_loops_ &&
           (keyframes_since_ >= interval || (is_urgent_ && keyframes_since_ >= options_.min_interval_keyframes));
  }

  /// The noise is learnt anew when a tenth more loops have come since the last time.
  Effort effort(bool is_end) const {
    if (is_end || is_withdrawn_) return Effort::kFull;
    constexpr std::size_t kGrowth = 10;
    return trajectory_.loops.size() > learnt_loops_ + learnt_loops_ / kGrowth ? Effort::kLearn : Effort::kUpdate;
  }

  bool optimize(bool is_end) {
    const Effort effort = this->effort(is_end);
    keyframes_since_ = 0;
    has_new_loops_ = is_upset_ = is_urgent_ = is_withdrawn_ = false;
    for (std::size_t i = 0; i < trajectory_.edges.size(); ++i) {
      const MotionBursts::Suspect suspect = bursts_.suspect(i);
      OdometryEdge& edge = trajectory_.edges[i];
      edge.suspect.head<3>() = q_camera_odom_[i + 1] * suspect.motion.head<3>();
      edge.suspect.tail<3>() = q_camera_odom_[i + 1] * suspect.motion.tail<3>();
      edge.suspect_error_m = suspect.error_m;
      edge.suspect_error_rad = suspect.error_rad;
    }
    if (has_objects_ && is_end) trajectory_.objects.objects = objects_.objects();
    if (!(has_free_scale() ? optimize_similarities(effort) : optimize_poses(effort))) return false;
    if (effort != Effort::kUpdate) learnt_loops_ = trajectory_.loops.size();
    T_map_odom_ = trajectory_.T_map_vertex.back() * T_odom_keyframe_.inverse();
    return true;
  }

  bool optimize_poses(Effort effort) {
    if (options_.robust == "gnc") trajectory_.votes = consistency_.vote(trajectory_.edges, trajectory_.loops);
    const bool is_doubted = effort == Effort::kFull && options_.robust == "gnc";
    if (is_doubted && !tell_right_loops()) return false;
    OptimizedTrajectory result =
        optimize_trajectory(trajectory_, options_, knowledge_, is_doubted ? Effort::kSettle : effort);
    if (!result.usable) return false;
    trajectory_.T_map_vertex = std::move(result.T_map_vertex);
    knowledge_ = std::move(result.knowledge);
    return true;
  }

  /// The scales that the loops state come first; what they leave open, the poses tell. Loops are judged and noise is
  /// learnt in the map's unit of length, once at the scales stated and once at those found.
  bool optimize_similarities(Effort effort) {
    std::vector<double> log_scale = estimate_log_scales(trajectory_, options_);
    const std::vector<bool> votes = scale_votes(trajectory_, log_scale);
    std::vector<SE3> T_map_vertex = trajectory_.T_map_vertex;
    constexpr int kRounds = 2;
    for (int round = 0; round < kRounds; ++round) {
      Trajectory scaled = in_map_unit(trajectory_, log_scale);
      scaled.T_map_vertex = T_map_vertex;
      if (options_.robust == "gnc") {
        consistency_.clear();
        trajectory_.votes = consistency_.vote(scaled.edges, scaled.loops);
        for (std::size_t k = 0; k < votes.size(); ++k) trajectory_.votes[k] = trajectory_.votes[k] && votes[k];
        scaled.votes = trajectory_.votes;
      }
      OptimizedTrajectory rigid = optimize_trajectory(scaled, options_, knowledge_, effort);
      if (!rigid.usable || !solve_scales(trajectory_, rigid, options_, &T_map_vertex, &log_scale)) return false;
      knowledge_ = std::move(rigid.knowledge);
    }
    trajectory_.T_map_vertex = std::move(T_map_vertex);
    log_scale_ = std::move(log_scale);
    return true;
  }

  /// Doubts every loop anew. Loops that were outvoted by false ones get another chance.
  bool tell_right_loops() {
    const std::vector<bool> voted = trajectory_.votes;
    if (!classify()) return false;
    std::vector<bool> eligible = knowledge_.kept;
    for (std::size_t k = 0; k < voted.size(); ++k) eligible[k] = eligible[k] || !voted[k];
    trajectory_.votes = consistency_.vote(trajectory_.edges, trajectory_.loops, eligible, knowledge_.kept);
    if (trajectory_.votes != knowledge_.kept && !classify()) return false;
    forget_false_loops(voted);
    if (!judge_as_if_false_ones_never_came({})) return false;
    const std::vector<bool> unsurprising = without_surprising_clusters(trajectory_, options_, knowledge_);
    return unsurprising == knowledge_.kept || judge_as_if_false_ones_never_came(unsurprising);
  }

  /// Where right loops lie at the border, what was rejected on the way there sways the verdict on them. So the last one
  /// is made anew among those that are not far off.
  /// @param believed one a loop: those that were kept and are no more are false; empty: none is
  bool judge_as_if_false_ones_never_came(const std::vector<bool>& believed) {
    constexpr double kFarOff = 10.0;  // times the bound
    std::vector<bool> eligible;
    for (std::size_t k = 0; k < trajectory_.loops.size(); ++k) {
      const bool is_false = !believed.empty() && knowledge_.kept[k] && !believed[k];
      eligible.push_back(!is_false && chi2(trajectory_.loops[k]) <= kFarOff * options_.robust_chi2);
    }
    const std::vector<bool> none(eligible.size(), false);
    trajectory_.votes = consistency_.vote(trajectory_.edges, trajectory_.loops, eligible, none);
    if (!classify()) return false;
    forget_false_loops(eligible);
    return true;
  }

  bool classify() {
    OptimizedTrajectory result = optimize_trajectory(trajectory_, options_, knowledge_, Effort::kClassify);
    if (!result.usable) return false;
    trajectory_.T_map_vertex = std::move(result.T_map_vertex);
    knowledge_ = std::move(result.knowledge);
    return true;
  }

  /// A loop found false shall leave no trace: which loops repeat others follows from those that fit.
  /// @param voted in the first round: says why a loop is not kept
  void forget_false_loops(const std::vector<bool>& voted) {
    const std::vector<bool> kept = std::move(knowledge_.kept);
    trajectory_.loops.clear();
    trajectory_.votes.clear();
    knowledge_.kept.clear();
    for (Entry& entry : entries_) {
      if (!entry.loop) continue;
      const bool was_in_graph = entry.index >= 0;
      const auto index = static_cast<std::size_t>(entry.index);
      const bool fits = was_in_graph ? kept[index] : chi2(*entry.loop) <= options_.robust_chi2;
      const bool has_vote = fits || !was_in_graph || voted[index];
      entry.index = -1;
      if (fits && is_repetition(*entry.loop)) continue;
      entry.index = static_cast<int>(trajectory_.loops.size());
      trajectory_.loops.push_back(*entry.loop);
      trajectory_.votes.push_back(has_vote);
      knowledge_.kept.push_back(fits);
    }
    consistency_.clear();
  }

  LoopVerdict verdict(const Entry& entry) const {
    LoopVerdict verdict{entry.query_keyframe_id, entry.match_keyframe_id, false, entry.refusal, entry.is_extra};
    if (!entry.loop) return verdict;
    const double factor = knowledge_.noise.loop_factor;
    const double disagreement = chi2(*entry.loop) / (factor * factor);
    const bool is_in_graph = entry.index >= 0;
    verdict.kept =
        is_in_graph ? knowledge_.kept[static_cast<std::size_t>(entry.index)] : disagreement <= options_.robust_chi2;
    const auto index = static_cast<std::size_t>(entry.index);
    if (is_in_graph && index < trajectory_.votes.size() && !trajectory_.votes[index]) {
      verdict.reason = "no other loop agrees with it or more disagree";
    } else if (!verdict.kept) {
      std::ostringstream reason;
      reason << "disagrees with the odometry and the other loops: squared error " << std::setprecision(3)
             << disagreement << " sigma^2";
      verdict.reason = reason.str();
    } else if (!is_in_graph) {
      verdict.reason = "repeats the evidence of other loops";
    }
    return verdict;
  }

  OdometryReport odometry_report() const {
    const NoiseEstimate& noise = knowledge_.noise;
    OdometryReport report;
    report.translation_m = noise.odometry.translation_m;
    report.rotation_rad = noise.odometry.rotation_rad;
    report.steady_translation = noise.odometry.steady_translation;
    report.steady_rotation_rad = noise.odometry.steady_rotation_rad;
    report.scale = noise.odometry.scale;
    report.loop_factor = noise.loop_factor;
    std::map<std::size_t, OdometryFault> faults;  // by edge
    const auto fault = [this, &faults](std::size_t edge) -> OdometryFault& {
      OdometryFault& fault = faults[edge];
      fault.from_keyframe_id = keyframes_[edge].keyframe_id;
      fault.to_keyframe_id = keyframes_[edge + 1].keyframe_id;
      return fault;
    };
    for (std::size_t i = 0; i < trajectory_.edges.size(); ++i) {
      report.stated_edges += trajectory_.edges[i].covariance ? 1 : 0;
      if (trajectory_.edges[i].is_break) fault(i).is_break = true;
    }
    for (const OdometryJump& jump : noise.jumps) {
      fault(jump.edge).translation_m = jump.translation_m;
      fault(jump.edge).rotation_rad = jump.rotation_rad;
    }
    for (const auto& [edge, entry] : faults) report.faults.push_back(entry);
    return report;
  }

  std::vector<LoopVerdict> verdicts() const {
    std::vector<LoopVerdict> verdicts;
    for (const Entry& entry : entries_) verdicts.push_back(verdict(entry));
    return verdicts;
  }

  PoseGraphOptions options_;
  Trajectory trajectory_;
  std::vector<KeyframePose> keyframes_;
  std::map<std::int64_t, int> vertex_of_;
  bool has_objects_ = false;
  ObjectMemory objects_;
  OdometryAccumulator accumulator_;
  MotionBursts bursts_;
  LoopConsistency consistency_;
  std::vector<Quaternion> q_camera_odom_;  ///< of the keyframes
  SE3 T_odom_keyframe_;                    ///< of the last keyframe
  SE3 T_odom_frame_;                       ///< of the last frame
  std::vector<double> log_scale_;  ///< of the map's unit of length over the odometry's, one a vertex; 0 unless free
  SE3 T_map_odom_;
  GraphKnowledge knowledge_;
  std::vector<Entry> entries_;  ///< in order of acceptance
  std::size_t learnt_loops_ = 0;
  int keyframes_since_ = 0;
  bool has_new_loops_ = false, is_upset_ = false, is_urgent_ = false, is_withdrawn_ = false;
};

PoseGraph::PoseGraph(const PoseGraphOptions& options) : impl_(std::make_unique<Impl>(options)) {}
PoseGraph::~PoseGraph() = default;
PoseGraph::PoseGraph(PoseGraph&&) noexcept = default;
PoseGraph& PoseGraph::operator=(PoseGraph&&) noexcept = default;

void PoseGraph::observe(const Frame& frame, const AssociationFrame& associations) {
  impl_->observe(frame, associations);
}
void PoseGraph::apply(const MapUpdate& update) { impl_->apply(update); }
MapCorrection PoseGraph::process(const Frame& frame, const std::vector<LoopClosure>& loops,
                                 const std::vector<LoopClosure>& extra_loops) {
  return impl_->process(frame, loops, extra_loops);
}
bool PoseGraph::withdraw(std::int64_t query_keyframe_id, std::int64_t match_keyframe_id) {
  return impl_->withdraw(query_keyframe_id, match_keyframe_id);
}
const SE3& PoseGraph::T_map_odom() const { return impl_->T_map_odom(); }
std::vector<KeyframePose> PoseGraph::keyframes() const { return impl_->keyframes(); }

}  // namespace semantic_topo_loop::core
