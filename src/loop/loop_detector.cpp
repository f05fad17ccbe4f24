#include "semantic_topo_loop/loop/loop_detector.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <map>
#include <sstream>
#include <tuple>

#include "geometry/relative_pose.h"
#include "loop/graph/graph_detector.h"
#include "loop/graph/odometry_monitor.h"
#include "loop/graph/relocalisation.h"
#include "loop/pair_record.h"
#include "loop/paper/paper_detector.h"
#include "loop/submap/missed_motion.h"
#include "loop/submap/observation_window.h"
#include "loop/submap/submap_builder.h"
#include "loop/submap/window_solver.h"
#include "odometry/motion_bursts.h"
#include "odometry/odometry_edge.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/loop/loop_options.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::int64_t kSettle_ns = 300'000'000;  ///< a jump may take several frames
/// A frozen odometry that goes on stands out as a burst does, which is told at most so much later.
constexpr std::int64_t kResume_ns = 1'500'000'000;
constexpr std::size_t kRecordCapacity = 20'000;  ///< decisions that are explained without a new comparison: some 6 MB

}  // namespace

struct LoopDetector::Impl {
  Impl(const LoopOptions& options, const ClassTable& classes)
      : options_(options),
        paper_mode_(options.mode == "paper"),
        window_(paper_mode_ ? options.paper_window_s : options.window_s, options.frame_interval_s, classes),
        monitor_(options.max_depth_m),
        up_(options.up_window_s),
        graph_(options),
        paper_(options, redirects_) {}

  void apply(const MapUpdate& update) {
    redirects_.apply(update);
    if (paper_mode_) paper_.apply(update);
  }

  std::vector<LoopClosure> detect(const Frame& frame, const AssociationFrame& associations) {
    motions_.clear();
    if (frame.is_end || !frame.T_odom_camera.is_finite()) return {};
    if (frame.is_keyframe) keyframes_[frame.keyframe_id] = {frame.frame_id, frame.stamp_ns, frame.T_odom_camera};
    std::vector<LoopClosure> loops = detect_by_objects(frame, associations);
    if (std::optional<LoopClosure> loop = take_source_loop(frame)) loops.push_back(*std::move(loop));
    return loops;
  }

  /// What the odometry's source found itself, as a loop between keyframes.
  std::optional<LoopClosure> take_source_loop(const Frame& frame) {
    if (!frame.source_loop || !options_.enabled) return std::nullopt;
    const SourceLoop& found = *frame.source_loop;
    const auto match = std::find_if(keyframes_.rbegin(), keyframes_.rend(),
                                    [&found](const auto& entry) { return entry.second.stamp_ns <= found.stamp_ns; });
    const auto query = keyframes_.find(frame.keyframe_id);
    if (match == keyframes_.rend() || query == keyframes_.end() || match->first == query->first) return std::nullopt;
    if (match->first < first_keyframe_id_) return std::nullopt;  // another session's clock
    LoopClosure loop;
    loop.query_keyframe_id = query->first;
    loop.match_keyframe_id = match->first;
    loop.query_frame = query->second.frame_id;
    loop.match_frame = match->second.frame_id;
    std::tie(loop.query_begin, loop.query_end) = frames_around(query->second.stamp_ns);
    std::tie(loop.match_begin, loop.match_end) = frames_around(match->second.stamp_ns);
    loop.query_stamp_ns = query->second.stamp_ns;
    loop.match_stamp_ns = match->second.stamp_ns;
    loop.accepted = true;
    loop.reason = LoopReason::kFoundBySource;
    loop.inliers = found.points;
    const SE3 T_frame_query = frame.T_odom_camera.inverse() * query->second.T_odom_camera;
    loop.T_match_query = match->second.T_odom_camera.inverse() * found.T_odom_camera * T_frame_query;
    const Mat6 carry = transport(T_frame_query);
    loop.covariance = carry * found.covariance * carry.transpose();
    loop.state_sigmas(loop.covariance);
    record_.add({loop});
    return loop;
  }

  /// First and last keyframe's frame that loops of the odometry's source share evidence with: the points around are
  /// bent alike.
  std::pair<std::int64_t, std::int64_t> frames_around(std::int64_t stamp_ns) const {
    constexpr std::int64_t kAround_ns = 2'000'000'000;
    std::pair<std::int64_t, std::int64_t> frames{std::numeric_limits<std::int64_t>::max(), -1};
    for (auto it = keyframes_.rbegin();
         it != keyframes_.rend() && it->first >= first_keyframe_id_ && it->second.stamp_ns >= stamp_ns - kAround_ns;
         ++it) {
      if (it->second.stamp_ns > stamp_ns + kAround_ns) continue;
      frames.first = std::min(frames.first, it->second.frame_id);
      frames.second = std::max(frames.second, it->second.frame_id);
    }
    return frames;
  }

  std::vector<LoopClosure> detect_by_objects(const Frame& frame, const AssociationFrame& associations) {
    if (frame.is_break) begin_segment();
    if (frame.stamp_ns < settled_ns_) return {};
    const bool taken = window_.push(frame, associations);
    up_.push(frame);
    watch_odometry(frame, taken);
    if (associations.unanswered || !is_due(frame)) return {};
    const std::optional<std::size_t> anchor = middle_keyframe(window_.frames());
    if (!anchor) return {};
    const std::deque<ObservedFrame> window = paper_mode_ ? window_.frames() : solver_.solve(window_.frames(), *anchor);
    // A slip is not over yet, or is a jump, which the motion tells better, a little later.
    if (solver_.is_slipping()) return {};
    if (!paper_mode_ && options_.enabled) tell_motions(window, window[*anchor].keyframe_id);
    add_missed(window, *anchor);
    std::optional<LocalMap> map = build_local_map(window, redirects_, up_, options_);
    if (!map) return {};
    // What the odometry missed is between the reference and the frames to come.
    const auto is_missed = [](const ObservedFrame& frame) { return frame.missed.is_any(); };
    if (std::any_of(window.begin() + static_cast<std::ptrdiff_t>(*anchor) + 1, window.end(), is_missed)) {
      monitor_.restart();
    } else {
      monitor_.set_reference(*map);
    }
    if (paper_mode_) {
      std::vector<LoopClosure> loops = paper_.detect(std::move(*map), options_.enabled);
      record_.add(loops);
      return loops;
    }
    map->segment = segment_;
    map->missed = missed_;
    map->drift_rad_s = monitor_.drift_rad_s().value_or(0.0);
    std::vector<LoopClosure> loops;
    if (options_.enabled) {
      loops = graph_.detect(*map);
      record_.add(loops);
      if (earlier_) {
        for (LoopClosure& loop : earlier_->detect(*map)) {
          relocaliser_.add(loop, map->T_odom_anchor);
          loops.push_back(std::move(loop));
        }
      }
    }
    if (!is_fixed_) graph_.store(std::move(*map));
    return loops;
  }

  /// A place on the solved way through a window.
  struct Waypoint {
    std::optional<std::int64_t> keyframe_id;  ///< if it is one
    SE3 T_odom_camera;
    MissedMotion missed;  ///< since the waypoint before
  };

  /// From where the last window was known best, its middle.
  void tell_motions(const std::deque<ObservedFrame>& window, std::int64_t middle_keyframe_id) {
    const Waypoint *from = nullptr, *last = nullptr;
    SolvedMotion none;
    none.delay_s = solver_.applied_delay_s();
    none.noise = solver_.noise().odometry;
    SolvedMotion motion = none;
    WayCounter counter;
    const std::vector<Waypoint> way = way_through(window);
    for (const Waypoint& place : way) {
      if (last == nullptr) {
        counter.start(place.T_odom_camera);
      } else {
        counter.add(place.T_odom_camera);
        motion.missed = join(motion.missed, place.missed, last->T_odom_camera.inverse() * place.T_odom_camera);
      }
      last = &place;
      if (!place.keyframe_id) continue;
      std::tie(motion.path_m, motion.rotation_rad) = counter.take();
      if (from != nullptr && *from->keyframe_id >= told_from_) {
        motion.from_keyframe_id = *from->keyframe_id;
        motion.to_keyframe_id = *place.keyframe_id;
        motion.T_from_to = from->T_odom_camera.inverse() * place.T_odom_camera;
        motions_.push_back(motion);
      }
      from = &place;
      motion = none;
    }
    told_from_ = middle_keyframe_id;
  }

  /// Through a window's frames, and between them through the keyframes that no detector looked at: where the odometry
  /// has them, but for their share, by time, of what solving has changed.
  std::vector<Waypoint> way_through(const std::deque<ObservedFrame>& window) const {
    const auto part = [](const MissedMotion& missed, double share) {
      return MissedMotion{share * missed.frozen_s, share * missed.slipped_s, share * missed.covariance};
    };
    const std::deque<ObservedFrame>& measured = window_.frames();
    std::vector<Waypoint> way;
    for (std::size_t i = 0; i < window.size(); ++i) {
      double reached = 0.0;  // share of the time since the frame before
      for (auto next = i > 0 ? keyframes_.upper_bound(measured[i - 1].keyframe_id) : keyframes_.end();
           next != keyframes_.end() && next->second.frame_id < measured[i].frame_id; ++next) {
        const ObservedFrame &before = measured[i - 1], &after = measured[i];
        const SE3 T_before_odom = before.T_odom_camera.inverse();
        const double share = static_cast<double>(next->second.stamp_ns - before.stamp_ns) /
                             static_cast<double>(after.stamp_ns - before.stamp_ns);
        const SE3 T_before_keyframe =
            motion_on_the_way(T_before_odom * next->second.T_odom_camera, T_before_odom * after.T_odom_camera,
                              window[i - 1].T_odom_camera.inverse() * window[i].T_odom_camera, share);
        way.push_back(
            {next->first, window[i - 1].T_odom_camera * T_before_keyframe, part(window[i].missed, share - reached)});
        reached = share;
      }
      const std::optional<std::int64_t> keyframe_id =
          window[i].is_keyframe ? std::optional(window[i].keyframe_id) : std::nullopt;
      way.push_back({keyframe_id, window[i].T_odom_camera, part(window[i].missed, 1.0 - reached)});
    }
    return way;
  }

  SubmapDelta take_delta(bool whole) {
    SubmapDelta delta;
    delta.is_whole = whole || !has_told_;
    has_told_ = true;
    std::vector<std::int64_t> kept;
    kept.reserve(graph_.submaps().size());
    for (const auto& [number, stored] : graph_.submaps()) {
      const std::int64_t frame_id = stored.map.frame_id;
      kept.push_back(frame_id);
      const bool is_told = std::binary_search(told_submaps_.begin(), told_submaps_.end(), frame_id);
      if (delta.is_whole || !is_told) delta.added.push_back(stored.map);
    }
    std::sort(kept.begin(), kept.end());
    if (!delta.is_whole) {
      std::set_difference(told_submaps_.begin(), told_submaps_.end(), kept.begin(), kept.end(),
                          std::back_inserter(delta.forgotten));
    }
    told_submaps_ = std::move(kept);
    record_.take_delta(&delta);
    return delta;
  }

  LoopExplanation explain(std::int64_t query_id, std::int64_t match_id) const {
    for (const std::int64_t id : {query_id, match_id}) {
      if (keyframes_.count(id) == 0) return {PairStatus::kUnknownKeyframe, unknown_keyframe(id), std::nullopt};
    }
    if (query_id <= match_id) {
      return {PairStatus::kWrongOrder, "the query must be the later of the two keyframes", std::nullopt};
    }
    if (const LoopFigures* loop = record_.find(query_id, match_id)) return verified(*loop);
    if (paper_mode_) {
      return {PairStatus::kNotAttempted, "paper mode judges the best candidate of each keyframe, which was another one",
              std::nullopt};
    }
    return explain_by_submaps(query_id, match_id);
  }

  struct KeyframeTime {
    std::int64_t frame_id = -1;
    std::int64_t stamp_ns = 0;
    SE3 T_odom_camera;
  };

  std::string unknown_keyframe(std::int64_t id) const {
    std::ostringstream text;
    text << "keyframe " << id << " is unknown";
    if (!keyframes_.empty())
      text << ": there are " << keyframes_.begin()->first << " to " << keyframes_.rbegin()->first;
    return text.str();
  }

  LoopExplanation verified(const LoopFigures& loop) const {
    std::ostringstream text;
    text << "keyframes " << loop.query_keyframe_id << " and " << loop.match_keyframe_id << ' '
         << describe(loop, options_);
    LoopClosure closure;
    static_cast<LoopFigures&>(closure) = loop;
    return {PairStatus::kVerified, text.str(), closure};
  }

  std::optional<int> submap_about(std::int64_t keyframe_id) const {
    const KeyframeTime& keyframe = keyframes_.at(keyframe_id);
    return graph_.submap_about(keyframe.frame_id, keyframe.stamp_ns);
  }

  /// Places are compared by submaps, each of which speaks for all keyframes that it spans.
  LoopExplanation explain_by_submaps(std::int64_t query_id, std::int64_t match_id) const {
    const std::optional<int> query = submap_about(query_id), match = submap_about(match_id);
    if (match) {
      const LoopFigures* loop = record_.find(query_id, anchor(*match));
      if (loop == nullptr && query) loop = record_.find(anchor(*query), anchor(*match));
      if (loop != nullptr) return verified(*loop);
    }
    if (!query || !match) {
      return {PairStatus::kNoSubmap,
              "no submap was kept about keyframe " + std::to_string(match ? query_id : match_id) +
                  ": too few objects or too little time since the start, a break or a jump of the odometry, or others "
                  "that see the place alike tell more",
              std::nullopt};
    }
    if (*query == *match) {
      return {PairStatus::kTooRecent, "both keyframes belong to one submap", std::nullopt};
    }
    const GraphDetector::Comparison comparison = graph_.compare(*query, *match);
    LoopExplanation answer{status(*query, *match, comparison), {}, comparison.closure};
    std::ostringstream text;
    text << to_string(answer.status) << ": the submaps about keyframes " << anchor(*query) << " and " << anchor(*match)
         << " are ";
    if (const std::optional<double> gap_s = this->gap_s(*query, *match)) {
      text << *gap_s << " s apart (>= " << options_.min_gap_s << ')';
    } else {
      text << "of two sessions";
    }
    text << " and share " << comparison.agreeing_pairs << " pairs of objects";
    if (answer.closure) text << "; compared now, they would be " << describe(*answer.closure, options_);
    answer.text = text.str();
    return answer;
  }

  PairStatus status(int query, int match, const GraphDetector::Comparison& comparison) const {
    const std::optional<double> gap_s = this->gap_s(query, match);
    if (gap_s && *gap_s < options_.min_gap_s) return PairStatus::kTooRecent;
    if (!comparison.proposed) return PairStatus::kNotProposed;
    return comparison.closure ? PairStatus::kNotAttempted : PairStatus::kNoAlignment;
  }

  const LocalMap& submap(int number) const { return graph_.submaps().at(number).map; }
  std::int64_t anchor(int number) const { return submap(number).keyframe_id; }
  /// @return nullopt between two sessions, whose clocks may not be one
  std::optional<double> gap_s(int query, int match) const {
    const auto is_own = [this](int number) { return submap(number).segment >= 0; };
    const double gap_s = 1e-9 * static_cast<double>(submap(query).stamp_ns - submap(match).stamp_ns);
    if (is_own(query) != is_own(match) || gap_s < 0.0) return std::nullopt;
    return gap_s;
  }

  /// By time: a camera that hardly moves makes few keyframes, but every view of a known place shall be recognised at
  /// once; and what one keyframe has closed the next one hardly need close again. The paper asks at keyframes.
  bool is_due(const Frame& frame) {
    const bool waited = frame.stamp_ns - last_attempt_ns_ >= std::llround(1e9 * options_.attempt_interval_s);
    if (!waited && !(paper_mode_ && frame.is_keyframe)) return false;
    last_attempt_ns_ = frame.stamp_ns;
    return true;
  }

  void begin_segment() {
    monitor_.restart();
    relocaliser_.restart();
    settled_ns_ = 0;
    ++segment_;
  }

  /// What the odometry missed while it stood moves a submap against all from before. @param window solved, of which
  /// what ends by the anchor is taken in; the rest waits
  void add_missed(const std::deque<ObservedFrame>& window, std::size_t anchor) {
    missed_next_ = {};
    MissedMotion missed;
    std::size_t from = 0;  // the last frame before the odometry stood
    for (std::size_t i = 1; i < window.size(); ++i) {
      if (window[i].missed.frozen_s > 0.0) {
        missed = join(missed, window[i].missed, window[i - 1].T_odom_camera.inverse() * window[i].T_odom_camera);
        continue;
      }
      const std::size_t to = i - 1;
      if (missed.is_any() && window[to].stamp_ns > missed_ns_) {
        const auto measured = [this](std::size_t frame) {
          return pose_at_image(window_.frames(), frame, solver_.applied_delay_s());
        };
        const SE3 T_measured = measured(from).inverse() * measured(to);
        const SE3 T_solved = window[from].T_odom_camera.inverse() * window[to].T_odom_camera;
        const auto sigma = [](const Mat3& covariance) { return std::sqrt(covariance.trace()); };
        LocalMap::Missed& sum = i <= anchor ? missed_ : missed_next_;
        sum.translation_m += (T_solved.t - T_measured.t).norm() + sigma(missed.covariance.topLeftCorner<3, 3>());
        sum.rotation_rad +=
            rotation_angle(T_solved.q, T_measured.q) + sigma(missed.covariance.bottomRightCorner<3, 3>());
        if (i <= anchor) missed_ns_ = window[to].stamp_ns;
      }
      missed = {};
      from = i;
    }
  }

  /// Of the window, where the camera was.
  ObservedFrame last_frame() const {
    const std::deque<ObservedFrame>& frames = window_.frames();
    ObservedFrame frame = frames.back();
    if (frames.size() > 1) frame.T_odom_camera = pose_at_image(frames, frames.size() - 1, solver_.applied_delay_s());
    return frame;
  }

  /// A submap must not straddle a jump of the odometry, and spans less time the less is known of its motion.
  void watch_odometry(const Frame& frame, bool taken) {
    // The boxes show a jump at once, the motion by itself only once the jump is over; what stands out of it may be a
    // jolt of the camera.
    const std::optional<Vec6> burst = bursts_.push(frame);
    const bool is_seen =
        !window_.frames().empty() && frame.stamp_ns - window_.frames().back().stamp_ns < kBurstNoticed_ns;
    const bool has_burst = burst && !(is_seen && monitor_.refutes(*burst, last_frame()));
    const bool has_shift = taken && !window_.frames().empty() && monitor_.push(last_frame());
    if (has_burst || has_shift) {
      monitor_.restart();
      // What a frozen or slipping odometry missed is solved for; a burst is known better by the motion itself.
      const auto is_recent = [&frame](std::int64_t stamp_ns) { return frame.stamp_ns - stamp_ns < kResume_ns; };
      const std::optional<std::int64_t> frozen_ns = last_frozen_ns(window_.frames());
      std::optional<std::int64_t> slipped_ns;
      if (!has_burst) slipped_ns = solver_.last_slipped_ns(window_.frames());
      const bool is_missed =
          (frozen_ns && (has_shift || is_recent(*frozen_ns))) || (slipped_ns && is_recent(*slipped_ns));
      if (!is_missed) {
        missed_.translation_m += missed_next_.translation_m;
        missed_.rotation_rad += missed_next_.rotation_rad;
        missed_next_ = {};
        window_.clear();
        up_.clear();
        if (has_shift) settled_ns_ = frame.stamp_ns + kSettle_ns;
      }
    }
    // A burst is small: where the odometry sees itself still tells places apart, and where the map is.
    if (has_shift) {
      ++segment_;
      relocaliser_.restart();
    }
    if (const std::optional<double> span_s = solver_.span_s(radians(options_.window_sigma_deg))) {
      window_.set_span(std::clamp(*span_s, options_.min_window_s, options_.window_s));
    }
  }

  LoopOptions options_;
  bool paper_mode_;
  std::int64_t last_attempt_ns_ = 0;
  int segment_ = 0;
  LocalMap::Missed missed_;       ///< since the begin
  std::int64_t missed_ns_ = 0;    ///< up to which that is summed
  LocalMap::Missed missed_next_;  ///< from there to the end of the window
  std::int64_t settled_ns_ = 0;   ///< frames before are left out, after a jump
  ObservationWindow window_;
  WindowSolver solver_;
  OdometryMonitor monitor_;
  BurstWatch bursts_;
  UpEstimator up_;
  std::vector<SolvedMotion> motions_;  ///< see LoopDetector::motions
  std::int64_t told_from_ = -1;        ///< keyframe from which they are next told
  LandmarkRedirects redirects_;
  GraphDetector graph_;
  PaperDetector paper_;
  std::optional<GraphDetector> earlier_;  ///< of an earlier run's submaps
  Relocaliser relocaliser_;
  PairRecord record_{kRecordCapacity};
  std::map<std::int64_t, KeyframeTime> keyframes_;
  std::int64_t first_keyframe_id_ = 0;  ///< of this session: the stamps of others may be another clock's
  bool is_fixed_ = false;
  bool has_told_ = false;                   ///< take_delta, before
  std::vector<std::int64_t> told_submaps_;  ///< frame_ids of those that it told of, in order
};

LoopDetector::LoopDetector(const LoopOptions& options, std::shared_ptr<const ClassTable> classes)
    : impl_(new Impl(options, *classes), [](Impl* impl) { delete impl; }) {}

void LoopDetector::apply(const MapUpdate& update) { impl_->apply(update); }
std::vector<LoopClosure> LoopDetector::detect(const Frame& frame, const AssociationFrame& associations) {
  return impl_->detect(frame, associations);
}
const std::vector<SolvedMotion>& LoopDetector::motions() const { return impl_->motions_; }
double LoopDetector::odometry_delay_s() const { return impl_->solver_.delay_s(); }
void LoopDetector::set_options(const LoopOptions& options) {
  impl_->options_ = options;
  impl_->graph_.set_options(options);
  impl_->paper_.set_options(options);
  if (impl_->earlier_) impl_->earlier_->set_options(options);
}
LoopExplanation LoopDetector::explain(std::int64_t query_keyframe_id, std::int64_t match_keyframe_id) const {
  return impl_->explain(query_keyframe_id, match_keyframe_id);
}
void LoopDetector::set_earlier_map(std::vector<LocalMap> submaps) {
  GraphDetector& earlier = impl_->earlier_.emplace(impl_->options_);
  for (LocalMap& submap : submaps) {
    submap.is_earlier = true;
    submap.segment = std::min(submap.segment, LocalMap::kOtherSession);  // or another part of the map
    earlier.insert(std::move(submap));
  }
}
void LoopDetector::restore(std::vector<LocalMap> submaps, const std::vector<KeyframePose>& keyframes,
                           const std::vector<LoopFigures>& refused) {
  for (const KeyframePose& keyframe : keyframes) {
    impl_->keyframes_[keyframe.keyframe_id] = {keyframe.frame_id, keyframe.stamp_ns, keyframe.T_map_camera};
    impl_->first_keyframe_id_ = std::max(impl_->first_keyframe_id_, keyframe.keyframe_id + 1);
  }
  for (LocalMap& submap : submaps) {
    submap.segment = std::min(submap.segment, LocalMap::kOtherSession);  // or another part of the map
    impl_->graph_.insert(std::move(submap));
  }
  impl_->record_.restore(refused);
}
std::vector<LoopClosure> LoopDetector::detect(const std::vector<LocalMap>& queries) {
  std::vector<LoopClosure> loops;
  for (LocalMap query : queries) {
    query.segment = 0;  // where it stands beside the submaps kept so far means nothing
    for (LoopClosure& loop : impl_->graph_.detect(query)) loops.push_back(std::move(loop));
  }
  return loops;
}
std::optional<Relocalisation> LoopDetector::relocalisation() const { return impl_->relocaliser_.estimate(); }
void LoopDetector::set_fixed(bool fixed) { impl_->is_fixed_ = fixed; }
std::vector<LoopFigures> LoopDetector::refused() const { return impl_->record_.refused(); }
SubmapDelta LoopDetector::take_delta(bool whole) { return impl_->take_delta(whole); }
std::vector<LocalMap> LoopDetector::submaps() const {
  std::vector<LocalMap> submaps;
  for (const auto& [number, stored] : impl_->graph_.submaps()) submaps.push_back(stored.map);
  return submaps;
}

}  // namespace semantic_topo_loop::core
