#include "semantic_topo_loop/pose_graph/pose_graph.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>
#include <optional>
#include <utility>

#include "odometry/motion_bursts.h"
#include "pose_graph/graph_state.h"
#include "pose_graph/rejection/loop_rejection.h"
#include "pose_graph/scale/scaled_trajectory.h"
#include "pose_graph/solver/graph_objects.h"
#include "pose_graph/solver/segment_placement.h"
#include "pose_graph/solver/trajectory_optimizer.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop::core {
namespace {

/// What a graph holds at most, and what it is brought down to then: a solve within a run stays below a tenth of a
/// second on a laptop's core, and runs of some three minutes stay as they are.
constexpr std::size_t kMaxVertices = 400, kCoarseVertices = 300, kMaxLoops = 2 * kMaxVertices;
/// A keyframe that moved by less is not told again: no odometry resolves it.
constexpr double kMoved_m = 2e-4, kMoved_rad = 1e-4;

}  // namespace

struct PoseGraph::Impl {
  explicit Impl(const PoseGraphOptions& options) : options_(options), loops_(options_) {
    knowledge_.noise.odometry = noise_prior(options_).least;
    has_objects_ = options_.objects != "off" && !has_free_scale();
    set_object_noise();
  }

  void set_object_noise() { trajectory_.objects.noise = {options_.object_sigma_px, options_.object_sigma_share}; }

  void observe(const Frame& frame, const AssociationFrame& associations) {
    if (has_objects_ && is_vertex(frame))
      objects_.add(static_cast<int>(trajectory_.T_map_vertex.size()), frame.camera, associations);
  }

  void recall(std::int64_t keyframe_id, const Camera& camera, const AssociationFrame& associations) {
    if (!has_objects_) return;
    const Carrier carrier = this->carrier(number(keyframe_id));
    if (carrier.vertex >= 0 && !carrier.T_vertex_keyframe) objects_.add(carrier.vertex, camera, associations);
  }

  void apply(const MapUpdate& update) {
    if (!has_objects_) return;
    objects_.apply(
        update, [this](std::int64_t id) { return carrier(number(id)).vertex; }, trajectory_.T_map_vertex);
  }

  MapCorrection process(const Frame& frame, const std::vector<LoopClosure>& loops,
                        const std::vector<LoopClosure>& extra_loops) {
    MapCorrection correction;
    correction.frame_id = frame.frame_id;
    last_frame_id_ = frame.frame_id;
    if (frame.is_end) {
      suspect_jumps(&trajectory_.edges);
    } else {
      add_frame(frame);
    }
    correction.T_map_odom_old = T_map_odom_;
    for (const LoopClosure& loop : loops) add_loop(loop, false);
    for (const LoopClosure& loop : extra_loops) add_loop(loop, true);
    if (is_due(frame)) {
      const Stopwatch watch;
      correction.changed = optimize(frame.is_end);
      correction.duration_us = watch.elapsed_us();
    }
    if (has_free_scale()) T_map_odom_ = place(T_odom_frame_) * T_odom_frame_.inverse();
    correction.T_map_odom = T_map_odom_;
    correction.scale = log_scale_.empty() ? 1.0 : std::exp(log_scale_.back());
    if (!keyframes_.empty()) correction.valid_to_keyframe_id = keyframes_.back().keyframe_id;
    if (correction.changed) {
      correction.keyframes = moved_keyframes(frame.is_end);
      correction.loops =
          loops_.new_verdicts([this](const GraphLoop& loop) { return chi2(loop); }, knowledge_.noise.loop_factor);
      correction.odometry = odometry_report();
      loops_.bound(kMaxLoops);
    }
    if (trajectory_.T_map_vertex.size() > max_vertices_ && !has_free_scale()) coarsen();
    return correction;
  }

  void refine(const std::vector<SolvedMotion>& motions) {
    if (!motions.empty()) {
      delay_s_ = motions.back().delay_s;
      short_term_ = motions.back().noise;
    }
    for (const SolvedMotion& motion : motions) {
      const Carrier from = carrier(number(motion.from_keyframe_id)), to = carrier(number(motion.to_keyframe_id));
      const bool are_neighbours =
          from.vertex >= 0 && to.vertex == from.vertex + 1 && !from.T_vertex_keyframe && !to.T_vertex_keyframe;
      if (!are_neighbours) continue;
      const bool is_taken = trajectory_.edges[static_cast<std::size_t>(from.vertex)].refine(motion);
      is_refined_ = is_refined_ || is_taken;
    }
  }

  GraphState state() const {
    GraphState state = state_but_keyframes();
    for (std::size_t v = 0; v < keyframe_of_.size(); ++v) add_keyframes(v, keyframe_of_[v], &state);
    return state;
  }

  GraphDelta take_delta(bool whole) {
    GraphDelta delta{whole || written_.empty(), state_but_keyframes()};
    std::map<std::size_t, WrittenVertex> written;
    for (std::size_t v = 0; v < keyframe_of_.size(); ++v) {
      const std::size_t first = keyframe_of_[v];
      const WrittenVertex now{end_of(v), trajectory_.T_map_vertex[v], log_scale_[v]};
      const auto before = written_.find(first);
      if (delta.is_whole || before == written_.end()) {
        add_keyframes(v, first, &delta.state);
      } else {
        const std::size_t told = std::max(before->second.end, first);
        if (told > first && !now.is_where(before->second)) delta.state.keyframes.push_back(graph_keyframe(v, first));
        add_keyframes(v, told, &delta.state);
      }
      written.emplace_hint(written.end(), first, now);
    }
    written_ = std::move(written);
    return delta;
  }

  GraphKeyframe graph_keyframe(std::size_t vertex, std::size_t k) const {
    const bool is_vertex = k == keyframe_of_[vertex];
    return {followed(vertex, k), is_vertex ? std::nullopt : std::optional(T_vertex_keyframe_[k]), T_map_live_[k]};
  }

  /// @param k the first of them
  void add_keyframes(std::size_t vertex, std::size_t k, GraphState* state) const {
    for (; k < end_of(vertex); ++k) state->keyframes.push_back(graph_keyframe(vertex, k));
  }

  GraphState state_but_keyframes() const {
    GraphState state;
    state.sessions = sessions_;
    state.next_frame_id = std::max(next_frame_id_, last_frame_id_ + 1);
    if (keyframes_.size() > restored_) {
      state.sessions.push_back({keyframes_[restored_].keyframe_id, keyframes_[restored_].stamp_ns, last_stamp_ns_});
    }
    std::vector<OdometryEdge> edges = trajectory_.edges;
    suspect_jumps(&edges);
    // Poses and noise are those of the motions that the solution rests on.
    if (knowledge_.prefers_measured) state.edges = measured_edges(edges);
    if (state.edges.empty()) state.edges = std::move(edges);
    state.loops = loops_.remembered();
    state.accepted_loops = loops_.accepted();
    state.noise = knowledge_.noise;
    state.loose_factor = knowledge_.loose_factor;
    return state;
  }

  void restore(GraphState state, const std::optional<Vec3>& begin_at) {
    sessions_ = std::move(state.sessions);
    next_frame_id_ = state.next_frame_id;
    for (const auto& [pose, T_vertex_keyframe, T_map_live] : state.keyframes) {
      const std::size_t k = keyframes_.size();
      number_of_[pose.keyframe_id] = static_cast<int>(k);
      if (!T_vertex_keyframe) {
        keyframe_of_.push_back(k);
        trajectory_.T_map_vertex.push_back(pose.T_map_camera);
        log_scale_.push_back(std::log(pose.scale));
      }
      T_vertex_keyframe_.push_back(T_vertex_keyframe.value_or(SE3()));
      T_map_live_.push_back(T_map_live);
      q_camera_odom_.emplace_back(Quaternion::Identity());
      keyframes_.push_back(pose);
    }
    trajectory_.edges = std::move(state.edges);
    loops_.restore(std::move(state.loops), state.accepted_loops);
    knowledge_.noise = std::move(state.noise);
    knowledge_.loose_factor = state.loose_factor;
    restored_ = told_keyframes_ = keyframes_.size();
    begin_at_ = begin_at;
  }

  /// What was learnt of the map's odometry holds for its edges; that of the session that begins is another.
  void settle_odometry() {
    mark_sessions();
    loops_.hand_over(&trajectory_, &knowledge_);
    trajectory_.edges = settled_odometry(trajectory_, options_, knowledge_);
    knowledge_ = GraphKnowledge();
    knowledge_.noise.odometry = noise_prior(options_).least;
  }

  bool withdraw(std::int64_t query_keyframe_id, std::int64_t match_keyframe_id) {
    const std::size_t before = loops_.size();
    if (!loops_.withdraw(query_keyframe_id, match_keyframe_id)) return false;
    is_withdrawn_ = is_withdrawn_ || loops_.size() < before;
    return true;
  }

  std::vector<KeyframePose> keyframes() const {
    std::vector<KeyframePose> poses = keyframes_;
    for (std::size_t v = 0; v < keyframe_of_.size(); ++v) follow(v, &poses);
    return poses;
  }

  /// Whether the frame, which is not in the graph yet, becomes a vertex of it.
  bool is_vertex(const Frame& frame) const {
    return frame.is_keyframe && frame.T_odom_camera.is_finite() && number_of_.count(frame.keyframe_id) == 0;
  }

  bool has_free_scale() const { return options_.scale == "free"; }

  /// Where a camera behind the last keyframe is in the map.
  SE3 place(const SE3& T_odom_camera) const {
    // Those of earlier sessions are none of this odometry.
    if (!has_free_scale() || keyframes_.size() == restored_) return T_map_odom_ * T_odom_camera;
    const Sim3 S_map_keyframe(trajectory_.T_map_vertex.back(), std::exp(log_scale_.back()));
    return S_map_keyframe.pose(T_odom_keyframe_.inverse() * T_odom_camera);
  }

  void add_frame(const Frame& frame) {
    if (!frame.T_odom_camera.is_finite()) return;
    if (begin_at_) T_map_odom_.t = *std::exchange(begin_at_, std::nullopt) - frame.T_odom_camera.t;
    bursts_.push(frame, keyframes_.empty() ? 0 : keyframes_.size() - 1);
    last_stamp_ns_ = frame.stamp_ns;
    accumulator_.add(frame);
    T_odom_frame_ = frame.T_odom_camera;
    if (!is_vertex(frame)) return;
    if (!keyframes_.empty()) {
      if (keyframes_.size() == restored_ && !has_free_scale()) settle_odometry();
      trajectory_.edges.push_back(accumulator_.finish(T_odom_keyframe_, frame.T_odom_camera));
      // Nothing is known of the way from an earlier session to this one, which is to stay where it stands until a loop
      // tells.
      if (keyframes_.size() == restored_) {
        trajectory_.edges.back().is_break = true;
        trajectory_.edges.back().T_from_to = trajectory_.T_map_vertex.back().inverse() * place(frame.T_odom_camera);
      }
    }
    number_of_[frame.keyframe_id] = static_cast<int>(keyframes_.size());
    keyframe_of_.push_back(keyframes_.size());
    T_vertex_keyframe_.emplace_back();
    trajectory_.T_map_vertex.push_back(place(frame.T_odom_camera));
    T_map_live_.emplace_back(trajectory_.T_map_vertex.back());
    log_scale_.push_back(has_free_scale() && !log_scale_.empty() ? log_scale_.back() : 0.0);
    keyframes_.push_back({frame.keyframe_id, frame.frame_id, frame.stamp_ns, SE3()});
    T_odom_keyframe_ = frame.T_odom_camera;
    q_camera_odom_.push_back(T_odom_keyframe_.q.conjugate());
    ++keyframes_since_;
  }

  void add_loop(const LoopClosure& closure, bool is_extra) {
    if (!closure.accepted || closure.T_earlier_match) return;
    const GraphLoop* loop = loops_.add(closure, number(closure.query_keyframe_id), number(closure.match_keyframe_id),
                                       is_extra, [this](int k) { return carrier(k); });
    if (loop == nullptr) return;
    ++loops_since_learnt_;
    const double disagreement = chi2(*loop);
    has_new_loops_ = true;
    has_outliers_ = has_outliers_ || disagreement > options_.robust_chi2;
    is_urgent_ = is_urgent_ || disagreement > options_.urgent_chi2;
  }

  double chi2(const GraphLoop& loop) const {
    if (has_free_scale()) return chi_squared(loop, trajectory_.T_map_vertex, log_scale_);
    return chi_squared(loop, trajectory_.T_map_vertex);
  }

  /// @return -1 if the keyframe is unknown
  int number(std::int64_t keyframe_id) const {
    const auto found = number_of_.find(keyframe_id);
    return found == number_of_.end() ? -1 : found->second;
  }

  Carrier carrier(int number) const {
    if (number < 0) return {};
    const auto k = static_cast<std::size_t>(number);
    const auto after = std::upper_bound(keyframe_of_.begin(), keyframe_of_.end(), k);
    Carrier carrier{static_cast<int>(after - keyframe_of_.begin()) - 1, std::nullopt};
    if (*std::prev(after) != k) carrier.T_vertex_keyframe = T_vertex_keyframe_[k];
    return carrier;
  }

  /// The keyframes that move with a vertex: from its own to before that of the next one.
  std::size_t end_of(std::size_t vertex) const {
    return vertex + 1 < keyframe_of_.size() ? keyframe_of_[vertex + 1] : keyframes_.size();
  }

  /// A keyframe where its vertex has taken it.
  KeyframePose followed(std::size_t vertex, std::size_t k) const {
    const SE3& T_map_vertex = trajectory_.T_map_vertex[vertex];
    KeyframePose pose = keyframes_[k];
    pose.T_map_camera = k == keyframe_of_[vertex] ? T_map_vertex : T_map_vertex * T_vertex_keyframe_[k];
    pose.scale = std::exp(log_scale_[vertex]);
    return pose;
  }
  void follow(std::size_t vertex, std::vector<KeyframePose>* keyframes) const {
    for (std::size_t k = keyframe_of_[vertex]; k < end_of(vertex); ++k) (*keyframes)[k] = followed(vertex, k);
  }

  std::vector<KeyframePose> moved_keyframes(bool all) {
    std::vector<KeyframePose> moved;
    for (std::size_t v = 0; v < keyframe_of_.size(); ++v) {
      const KeyframePose& told = keyframes_[keyframe_of_[v]];
      const SE3& T_map_vertex = trajectory_.T_map_vertex[v];
      const bool is_same = keyframe_of_[v] < told_keyframes_ && told.scale == std::exp(log_scale_[v]) &&
                           (T_map_vertex.t - told.T_map_camera.t).norm() <= kMoved_m &&
                           rotation_angle(T_map_vertex.q, told.T_map_camera.q) <= kMoved_rad;
      if (is_same && !all) continue;
      follow(v, &keyframes_);
      moved.insert(moved.end(), keyframes_.begin() + static_cast<std::ptrdiff_t>(keyframe_of_[v]),
                   keyframes_.begin() + static_cast<std::ptrdiff_t>(end_of(v)));
    }
    told_keyframes_ = keyframes_.size();
    return moved;
  }

  void coarsen() {
    suspect_jumps(&trajectory_.edges);
    const std::vector<KeyframePose> poses = keyframes();
    const std::vector<std::size_t> keyframe_of = keyframe_of_;
    const std::vector<OdometryEdge> edges = trajectory_.edges;
    const std::vector<Carrier> carriers =
        core::coarsen(kCoarseVertices, loops_.at_vertices(keyframe_of.size()), &keyframe_of_, &trajectory_);
    forget_behind_breaks(keyframe_of, edges, carriers);
    // Where loops hold more, the next time comes as many vertices later.
    max_vertices_ = std::max(kMaxVertices, keyframe_of_.size() + kMaxVertices - kCoarseVertices);
    std::vector<double> log_scale(keyframe_of_.size());
    for (std::size_t v = 0; v < carriers.size(); ++v) {
      if (!carriers[v].T_vertex_keyframe) log_scale[static_cast<std::size_t>(carriers[v].vertex)] = log_scale_[v];
    }
    log_scale_ = std::move(log_scale);
    for (std::size_t v = 0; v < keyframe_of_.size(); ++v) {
      const SE3 T_vertex_map = trajectory_.T_map_vertex[v].inverse();
      for (std::size_t k = keyframe_of_[v]; k < end_of(v); ++k) {
        T_vertex_keyframe_[k] = T_vertex_map * poses[k].T_map_camera;
      }
    }
    for (auto& [first, vertex] : written_) vertex.end = 0;  // they hang on others now, or at another place of theirs
    loops_.move([&carriers](int v) { return carriers[static_cast<std::size_t>(v)]; });
    objects_.move(carriers);
    for (OdometryJump& jump : knowledge_.noise.jumps) {
      jump.edge = static_cast<std::size_t>(carriers[jump.edge].vertex);
    }
  }

  /// What went with a vertex from before a break is no place that a loop can still lead to.
  /// @param keyframe_of, edges before the vertices went   @param carriers of those vertices
  void forget_behind_breaks(const std::vector<std::size_t>& keyframe_of, const std::vector<OdometryEdge>& edges,
                            const std::vector<Carrier>& carriers) {
    bool is_lost = false;
    for (std::size_t v = 1; v < keyframe_of.size(); ++v) {
      is_lost = carriers[v].T_vertex_keyframe && (is_lost || edges[v - 1].is_break);
      if (!is_lost) continue;
      for (std::size_t k = keyframe_of[v]; k < keyframe_of[v + 1]; ++k) number_of_.erase(keyframes_[k].keyframe_id);
    }
  }

  /// Loops that the map agrees with can wait longer.
  bool is_due(const Frame& frame) const {
    if (is_withdrawn_) return true;
    if (frame.is_end && options_.objects == "on" && !objects_.empty()) return true;
    if (frame.is_end && is_refined_) return true;
    if (loops_.size() == 0) return false;
    if (frame.is_end) return true;
    constexpr int kPatience = 4;  // times the usual interval
    const int interval = has_outliers_ ? options_.interval_keyframes : kPatience * options_.interval_keyframes;
    return has_new_loops_ &&
           (keyframes_since_ >= interval || (is_urgent_ && keyframes_since_ >= options_.min_interval_keyframes));
  }

  /// The noise is learnt anew when a tenth more loops have come since the last time.
  Effort effort(bool is_end) const {
    if (is_end || is_withdrawn_) return Effort::kFull;
    constexpr std::size_t kTenth = 10;
    return loops_since_learnt_ > learnt_loops_ / kTenth ? Effort::kLearn : Effort::kUpdate;
  }

  /// This session's loops in the graph: those of a map tell nothing of its odometry.
  std::size_t own_loops() const {
    const auto is_own = [this](const RememberedLoop& entry) {
      return entry.is_in_graph && entry.loop->to >= trajectory_.session_begins.back();
    };
    const std::vector<RememberedLoop>& loops = loops_.remembered();
    return static_cast<std::size_t>(std::count_if(loops.begin(), loops.end(), is_own));
  }

  void mark_sessions() {
    const auto begin_at = [this](std::size_t k) {
      const auto first = std::lower_bound(keyframe_of_.begin(), keyframe_of_.end(), k);
      trajectory_.session_begins.push_back(static_cast<int>(first - keyframe_of_.begin()));
    };
    trajectory_.session_begins.clear();
    for (const Session& session : sessions_) {
      const int k = number(session.first_keyframe_id);
      if (k >= 0) begin_at(static_cast<std::size_t>(k));
    }
    begin_at(restored_);
  }

  bool optimize(bool is_end) {
    const Effort effort = this->effort(is_end);
    keyframes_since_ = 0;
    has_new_loops_ = has_outliers_ = is_urgent_ = is_withdrawn_ = false;
    mark_sessions();
    suspect_jumps(&trajectory_.edges);
    if (has_objects_) trajectory_.objects.objects = objects_.objects();
    loops_.hand_over(&trajectory_, &knowledge_);
    const std::vector<SE3> before = trajectory_.T_map_vertex;
    const bool is_solved = has_free_scale() ? optimize_similarities(effort) : optimize_poses(effort);
    loops_.take_back(trajectory_, knowledge_);
    trajectory_.objects.objects.clear();
    if (!is_solved) {
      trajectory_.T_map_vertex = before;  // what was tried on the way
      return false;
    }
    if (effort != Effort::kUpdate) {
      learnt_loops_ = own_loops();
      loops_since_learnt_ = 0;
    }
    T_map_odom_ = trajectory_.T_map_vertex.back() * T_odom_keyframe_.inverse();
    return true;
  }

  /// In this session's edges that are not joined: those of the others are settled.
  void suspect_jumps(std::vector<OdometryEdge>* edges) const {
    for (std::size_t i = 0; i < edges->size(); ++i) {
      if (keyframe_of_[i + 1] != keyframe_of_[i] + 1 || keyframe_of_[i] < restored_) continue;
      const MotionBursts::SuspectedJump jump = bursts_.suspected_jump(keyframe_of_[i]);
      const Quaternion& q_camera_odom = q_camera_odom_[keyframe_of_[i + 1]];
      OdometryEdge& edge = (*edges)[i];
      edge.suspected_jump.head<3>() = q_camera_odom * jump.motion.head<3>();
      edge.suspected_jump.tail<3>() = q_camera_odom * jump.motion.tail<3>();
      edge.jump_error_m = jump.error_m;
      edge.jump_error_rad = jump.error_rad;
    }
  }

  bool optimize_poses(Effort effort) {
    if (options_.robust == "gnc") trajectory_.votes = loops_.vote(trajectory_);
    place_segments(&trajectory_);
    const bool is_doubted = effort == Effort::kFull && options_.robust == "gnc";
    if (is_doubted && !loops_.reject_outliers(&trajectory_, &knowledge_)) return false;
    const bool asks_measured = effort == Effort::kFull || knowledge_.prefers_measured;
    if (asks_measured) trajectory_.measured = measured_edges(trajectory_.edges);
    OptimizedTrajectory result =
        optimize_trajectory(trajectory_, options_, knowledge_, is_doubted ? Effort::kSettle : effort);
    trajectory_.measured.clear();
    if (!result.usable) return false;
    trajectory_.T_map_vertex = std::move(result.T_map_vertex);
    knowledge_ = std::move(result.knowledge);
    return true;
  }

  /// The scales that the loops state come first; what they leave open, the poses tell. Loops are judged and noise is
  /// learnt in the map's unit of length, once at the scales stated and once at those found. Of the final audit what
  /// asks for clusters alone: which loops repeat others is not told anew.
  bool optimize_similarities(Effort effort) {
    std::vector<double> log_scale = estimate_log_scales(trajectory_, options_);
    const std::vector<bool> votes = scale_votes(trajectory_, log_scale);
    std::vector<SE3> T_map_vertex = trajectory_.T_map_vertex;
    constexpr int kRounds = 2;
    for (int round = 0; round < kRounds; ++round) {
      Trajectory scaled = in_map_unit(trajectory_, log_scale);
      scaled.T_map_vertex = T_map_vertex;
      if (options_.robust == "gnc") {
        trajectory_.votes = loops_.vote(scaled, true);
        for (std::size_t k = 0; k < votes.size(); ++k) trajectory_.votes[k] = trajectory_.votes[k] && votes[k];
        scaled.votes = trajectory_.votes;
      }
      place_segments(&scaled);
      OptimizedTrajectory rigid = optimize_trajectory(scaled, options_, knowledge_, effort);
      if (rigid.usable && effort == Effort::kFull && options_.robust == "gnc") audit(&scaled, &rigid);
      if (!rigid.usable || !solve_scales(trajectory_, rigid, options_, &T_map_vertex, &log_scale)) return false;
      knowledge_ = std::move(rigid.knowledge);
    }
    trajectory_.T_map_vertex = std::move(T_map_vertex);
    log_scale_ = std::move(log_scale);
    return true;
  }

  /// Solves without the clusters of loops that are false, if there are any.
  void audit(Trajectory* scaled, OptimizedTrajectory* rigid) const {
    scaled->T_map_vertex = rigid->T_map_vertex;
    scaled->votes = audit_clusters(*scaled, options_, rigid->knowledge);
    if (scaled->votes == rigid->knowledge.kept) return;
    *rigid = optimize_trajectory(*scaled, options_, rigid->knowledge, Effort::kSettle);
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
    report.delay_s = delay_s_;
    report.short_term = short_term_;
    std::map<std::size_t, OdometryFault> faults;  // by edge
    const auto fault = [this, &faults](std::size_t edge) -> OdometryFault& {
      OdometryFault& fault = faults[edge];
      fault.from_keyframe_id = keyframes_[keyframe_of_[edge]].keyframe_id;
      fault.to_keyframe_id = keyframes_[keyframe_of_[edge + 1]].keyframe_id;
      return fault;
    };
    for (std::size_t i = 0; i < trajectory_.edges.size(); ++i) {
      // Those of a map are settled.
      report.stated_edges += trajectory_.edges[i].covariance && keyframe_of_[i] >= restored_ ? 1 : 0;
      if (trajectory_.edges[i].is_break) fault(i).is_break = true;
      const MissedMotion& missed = trajectory_.edges[i].missed;
      if (missed.frozen_s > 0.0) fault(i).frozen_s = missed.frozen_s;
      if (missed.slipped_s > 0.0) fault(i).slipped_s = missed.slipped_s;
    }
    for (const OdometryJump& jump : noise.jumps) {
      fault(jump.edge).translation_m = jump.translation_m;
      fault(jump.edge).rotation_rad = jump.rotation_rad;
    }
    for (const auto& [edge, entry] : faults) report.faults.push_back(entry);
    return report;
  }

  /// What take_delta has told of a vertex.
  struct WrittenVertex {
    std::size_t end = 0;  ///< of the keyframes that move with it
    SE3 T_map_vertex;
    double log_scale = 0.0;

    bool is_where(const WrittenVertex& other) const {
      return log_scale == other.log_scale && T_map_vertex.t == other.T_map_vertex.t &&
             T_map_vertex.q.coeffs() == other.T_map_vertex.q.coeffs();
    }
  };

  PoseGraphOptions options_;
  Trajectory trajectory_;
  std::map<std::size_t, WrittenVertex> written_;  ///< by the index of its keyframe
  std::vector<KeyframePose> keyframes_;           ///< every one; poses as told last
  std::map<std::int64_t, int> number_of_;         ///< index of a keyframe in `keyframes_` by its id
  std::vector<std::size_t> keyframe_of_;        ///< index of each vertex's keyframe; those up to the next move with it
  std::vector<SE3> T_vertex_keyframe_;          ///< one a keyframe
  std::vector<std::optional<SE3>> T_map_live_;  ///< one a keyframe, see GraphKeyframe
  std::size_t max_vertices_ = kMaxVertices;     ///< more are brought down
  std::size_t told_keyframes_ = 0;              ///< how many were in the last solution
  std::size_t restored_ = 0;                    ///< how many are of earlier sessions
  std::vector<Session> sessions_;               ///< the earlier ones
  std::int64_t next_frame_id_ = 0;              ///< after those
  std::int64_t last_frame_id_ = -1, last_stamp_ns_ = 0;
  bool has_objects_ = false;
  ObjectMemory objects_;
  OdometryAccumulator accumulator_;
  MotionBursts bursts_;
  LoopRejection loops_;
  std::vector<Quaternion> q_camera_odom_;  ///< of the keyframes
  SE3 T_odom_keyframe_;                    ///< of the last keyframe
  SE3 T_odom_frame_;                       ///< of the last frame
  std::vector<double> log_scale_;  ///< of the map's unit of length over the odometry's, one a vertex; 0 unless free
  SE3 T_map_odom_;
  std::optional<Vec3> begin_at_;  ///< where the first camera is to stand, until it comes
  GraphKnowledge knowledge_;
  std::size_t learnt_loops_ = 0, loops_since_learnt_ = 0;
  int keyframes_since_ = 0;
  bool is_refined_ = false;  ///< some edge is not the odometry's own
  double delay_s_ = 0.0;     ///< see SolvedMotion
  ShortTermNoise short_term_;
  bool has_new_loops_ = false, has_outliers_ = false, is_urgent_ = false, is_withdrawn_ = false;
};

PoseGraph::PoseGraph(const PoseGraphOptions& options) : impl_(new Impl(options), [](Impl* impl) { delete impl; }) {}

void PoseGraph::observe(const Frame& frame, const AssociationFrame& associations) {
  impl_->observe(frame, associations);
}
void PoseGraph::recall(std::int64_t keyframe_id, const Camera& camera, const AssociationFrame& associations) {
  impl_->recall(keyframe_id, camera, associations);
}
void PoseGraph::apply(const MapUpdate& update) { impl_->apply(update); }
void PoseGraph::refine(const std::vector<SolvedMotion>& motions) { impl_->refine(motions); }
MapCorrection PoseGraph::process(const Frame& frame, const std::vector<LoopClosure>& loops,
                                 const std::vector<LoopClosure>& extra_loops) {
  return impl_->process(frame, loops, extra_loops);
}
GraphState PoseGraph::state() const { return impl_->state(); }
GraphDelta PoseGraph::take_delta(bool whole) { return impl_->take_delta(whole); }
void PoseGraph::restore(GraphState state, const std::optional<Vec3>& begin_at) {
  impl_->restore(std::move(state), begin_at);
}
bool PoseGraph::withdraw(std::int64_t query_keyframe_id, std::int64_t match_keyframe_id) {
  return impl_->withdraw(query_keyframe_id, match_keyframe_id);
}
void PoseGraph::set_options(const PoseGraphOptions& options) {
  impl_->options_ = options;
  impl_->set_object_noise();
}
const SE3& PoseGraph::T_map_odom() const { return impl_->T_map_odom_; }
PoseGraph::Size PoseGraph::size() const { return {impl_->trajectory_.T_map_vertex.size(), impl_->loops_.size()}; }
std::vector<KeyframePose> PoseGraph::keyframes() const { return impl_->keyframes(); }

}  // namespace semantic_topo_loop::core
