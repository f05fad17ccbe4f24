#include "semantic_topo_loop/association/object_associator.h"

#include <Eigen/Core>
#include <algorithm>
#include <deque>
#include <limits>
#include <numeric>
#include <optional>
#include <set>
#include <sstream>

#include "association/levels.h"
#include "association/track_store.h"
#include "geometry/assignment.h"
#include "geometry/depth_points.h"
#include "geometry/wide_image.h"
#include "semantic_topo_loop/geometry/quadric.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kMinProjection_px = 2.0;  // of either side: no detector boxes what is smaller
/// Twice the default of mapping.forget_unconfirmed_s, after which the map gives up itself what it has taken up.
constexpr std::int64_t kGiveUpAfter_ns = 600'000'000'000, kGiveUpInterval_ns = 60'000'000'000;
constexpr int kNoTrack = -1;                      // as assign_max has it
constexpr double kLongestPause_s = 10.0;          // between answers: no detector is slower, and a robot is elsewhere
constexpr double kProvisionalBaseline_deg = 3.0;  // with less parallax, boxes cannot have corrected a wrong depth

/// Splits "2d,pro,3d"; nullopt for a name that is no level.
std::optional<std::set<std::string>> parse_levels(const std::string& text) {
  std::set<std::string> levels;
  std::istringstream stream(text);
  for (std::string name; std::getline(stream, name, ',');) {
    if (name != "2d" && name != "pro" && name != "3d") return std::nullopt;
    levels.insert(name);
  }
  return levels.empty() ? std::nullopt : std::optional(levels);
}

}  // namespace

bool AssociatorOptions::is_level_list(const std::string& text) { return parse_levels(text).has_value(); }

struct ObjectAssociator::Impl {
  /// A track as it was when it was merged, without what was taken back from it since.
  struct MergedTrack {
    Track track;
    std::int64_t survivor_id = -1;
  };

  Impl(const AssociatorOptions& options, std::shared_ptr<const ClassTable> classes)
      : options_(options), classes_(std::move(classes)) {
    const std::set<std::string> names = parse_levels(options_.levels).value_or(std::set<std::string>{});
    if (names.count("2d") != 0) levels_.emplace_back(AssociationLevel::k2d, score_2d);
    if (names.count("pro") != 0) levels_.emplace_back(AssociationLevel::kPosterior, score_posterior);
    if (names.count("3d") != 0) levels_.emplace_back(AssociationLevel::k3d, score_3d);
  }

  AssociationFrame associate(const Frame& frame, const std::vector<Detection>& detections) {
    const Stopwatch stopwatch;
    AssociationFrame result = begin(frame);
    if (!frame.is_end) {
      points_.reset();
      prepare(frame, detections, &result);
      update_tracks(context_, assign(context_, &result), &result);
      give_up_unmapped(frame.stamp_ns);
      last_stamp_ns_ = frame.stamp_ns;
    }
    // What the map's changes cost here belongs to the frame that profits from them.
    result.duration_us = stopwatch.elapsed_us() + update_us_;
    update_us_ = 0.0;
    return result;
  }

  AssociationFrame begin(const Frame& frame) {
    if (frame.is_break) forget_boxes();
    AssociationFrame result;
    result.frame_id = frame.frame_id;
    result.map_version = map_version_;
    return result;
  }

  /// No track's last box tells any longer where it may be; what the map says of it stays.
  void forget_boxes() { context_.first_answer = context_.answer + 1; }

  bool apply(const MapUpdate& update) {
    if (update.base_version != map_version_) return false;
    const Stopwatch stopwatch;
    map_version_ = update.map_version;
    T_map_odom_ = update.T_map_odom;
    for (const LandmarkMerge& merge : update.unmerged) unmerge_tracks(merge);
    for (const LandmarkMerge& merge : update.merged) merge_tracks(merge);
    for (const std::int64_t id : update.removed) tracks_.erase(id);
    for (const Landmark& landmark : update.changed) set_geometry(landmark);
    update_us_ += stopwatch.elapsed_us();
    return true;
  }

  void merge_tracks(const LandmarkMerge& merge) {
    const Track* merged = tracks_.find(merge.merged_id);
    if (merged == nullptr) return;
    Track* survivor = tracks_.find(merge.survivor_id);
    if (survivor != nullptr && survivor != merged) {
      merged_tracks_.push_back({*merged, merge.survivor_id});
      if (merged_tracks_.size() > kMostOpenMerges) merged_tracks_.pop_front();
      for (const auto& [class_id, weight] : merged->class_weights) survivor->add_class_weight(class_id, weight);
      survivor->observations += merged->observations;
      if (merged->last_answer > survivor->last_answer) {
        survivor->last_answer = merged->last_answer;
        survivor->last_stamp_ns = merged->last_stamp_ns;
        survivor->last_keyframe_id = merged->last_keyframe_id;
        survivor->last_box = merged->last_box;
        tracks_.touch(survivor);
      }
    }
    tracks_.erase(merge.merged_id);
  }

  /// The merged track comes back as it was. Who has it by now, and those that went there with it, give it up.
  void unmerge_tracks(const LandmarkMerge& merge) {
    const auto record = merged_track(merge.merged_id);
    if (record == merged_tracks_.end()) return;
    Track& restored = tracks_.create(merge.merged_id);
    restored = record->track;
    merged_tracks_.erase(record);
    tracks_.place(&restored);
    tracks_.touch(&restored);
    std::int64_t holder_id = merge.survivor_id;
    for (auto later = merged_track(holder_id); later != merged_tracks_.end(); later = merged_track(holder_id)) {
      give_up(restored, &later->track);
      holder_id = later->survivor_id;
    }
    if (Track* holder = tracks_.find(holder_id)) give_up(restored, holder);
  }

  std::deque<MergedTrack>::iterator merged_track(std::int64_t id) {
    return std::find_if(merged_tracks_.begin(), merged_tracks_.end(),
                        [id](const MergedTrack& merged) { return merged.track.id == id; });
  }

  static void give_up(const Track& merged, Track* holder) {
    for (const auto& [class_id, weight] : merged.class_weights) holder->add_class_weight(class_id, -weight);
    holder->observations = std::max<std::int64_t>(1, holder->observations - merged.observations);
  }

  void set_geometry(const Landmark& landmark) {
    Track* track = tracks_.find(landmark.id);
    if (track == nullptr) {
      // The map speaks of a landmark that was given up here meanwhile (real time): take it back.
      track = &tracks_.create(landmark.id);
      const auto record = merged_track(landmark.id);
      if (record != merged_tracks_.end()) merged_tracks_.erase(record);
      track->observations = landmark.observations;
      for (const ClassCount& counted : landmark.class_counts) track->add_class_weight(counted.class_id, counted.count);
      if (landmark.class_counts.empty()) track->add_class_weight(landmark.class_id, landmark.observations);
      // Ids are given out one after the other: one beyond is nobody's, whatever a message says.
      constexpr std::int64_t kBeyond = std::numeric_limits<std::int64_t>::max() / 2;
      if (landmark.id < kBeyond) next_id_ = std::max(next_id_, landmark.id + 1);
    }
    track->state = landmark.state;
    track->has_ellipsoid = landmark.ellipsoid.has_value();
    track->is_provisional = track->has_ellipsoid && landmark.baseline_deg < kProvisionalBaseline_deg;
    if (track->has_ellipsoid) {
      track->center_map = landmark.ellipsoid->center();
      track->shape_map = landmark.ellipsoid->shape();
      track->size_m = 2.0 * landmark.ellipsoid->semi_axes.maxCoeff();
      track->points_map.clear();
    }
    tracks_.place(track);
  }

  /// Undistorts, gates and suppresses the detections; finds the tracks that the frame may see.
  void prepare(const Frame& frame, const std::vector<Detection>& detections, AssociationFrame* result) {
    AssociationContext& context = context_;
    context.detections.clear();
    context.tracks.clear();
    context.frame = &frame;
    context.interval_s = last_stamp_ns_ ? 1e-9 * static_cast<double>(frame.stamp_ns - *last_stamp_ns_) : 0.0;
    if (context.interval_s > kLongestPause_s) forget_boxes();
    ++context.answer;
    const SE3 T_map_camera = T_map_odom_ * frame.T_odom_camera;
    context.P_image_map = projection_matrix(frame.camera, T_map_camera);
    context.image = frame.camera.image();
    prepare_detections(frame, detections, result);
    const auto recent = [&](const Track& track) { return is_recent(track, frame); };
    if (options_.mode == "jda") {
      for (const Track* track : tracks_.all()) consider(*track);
    } else {
      for (const Track* track : tracks_.near(frame.camera, T_map_camera, options_.range_m, recent)) consider(*track);
    }
  }

  void consider(const Track& track) {
    if (track.state == LandmarkState::kRetired) return;
    const std::optional<Box> projection = visible_projection(track, context_);
    const bool recent_track = is_recent(track, *context_.frame);
    if (projection || recent_track || !track.points_map.empty()) {
      context_.tracks.push_back({&track, projection, recent_track});
    }
  }

  void prepare_detections(const Frame& frame, const std::vector<Detection>& detections, AssociationFrame* result) {
    const Camera& camera = frame.camera;
    const SE3 T_map_camera = T_map_odom_ * frame.T_odom_camera;
    if (frame.points_camera && !detections.empty()) points_.emplace(*frame.points_camera, camera);
    result->associations.resize(detections.size());
    gated_.clear();
    for (std::size_t i = 0; i < detections.size(); ++i) {
      const Detection& detection = detections[i];
      Association& association = result->associations[i];
      association.detection_index = static_cast<std::int32_t>(i);
      association.class_id = detection.class_id;
      association.score = detection.score;
      // Some detectors go on beyond the image.
      association.box = camera.undistort(clip(detection.box, camera.width, camera.height));
      association.truncated =
          truncated_sides(detection.box, camera.width, camera.height, options_.border_px * pixel_factor(camera));
      const bool is_in_view = association.box.is_valid();  // and not where the lens model holds no longer
      if (!is_in_view) association.box = {};
      if (!is_in_view || !classes_->is_mappable(detection.class_id)) {
        association.level = AssociationLevel::kIgnored;
      } else if (detection.score < options_.min_score) {
        association.level = AssociationLevel::kLowScore;
      } else {
        std::vector<Placement> placements = points_ ? place(*points_, association.box) : std::vector<Placement>();
        const auto implausible = std::remove_if(placements.begin(), placements.end(), [&](const Placement& placement) {
          return !is_plausible(association, placement.size_m);
        });
        if (!placements.empty() && implausible == placements.begin()) {
          association.level = AssociationLevel::kWrongSize;
          continue;
        }
        placements.erase(implausible, placements.end());
        for (Placement& placement : placements) placement.center = T_map_camera * placement.center;
        gated_.push_back({association, clip(association.box, context_.image), std::move(placements)});
      }
    }
    suppress(result);
  }

  /// Whether there are things of this class so large; what the border cuts may be larger than it seems.
  bool is_plausible(const Association& association, double size_m) const {
    const ObjectClass* object_class = classes_->find(association.class_id);
    const double factor = 1.0 + options_.size_tolerance;
    return object_class == nullptr || (size_m <= factor * object_class->size_max_m &&
                                       (association.truncated != 0 || factor * size_m >= object_class->size_min_m));
  }

  /// Cross-class non-maximum suppression: detectors box one object under two names.
  void suppress(AssociationFrame* result) {
    by_score_.resize(gated_.size());
    std::iota(by_score_.begin(), by_score_.end(), 0);
    std::sort(by_score_.begin(), by_score_.end(), [this](std::size_t a, std::size_t b) {
      return gated_[a].score > gated_[b].score || (gated_[a].score == gated_[b].score && a < b);
    });
    is_kept_.assign(gated_.size(), false);
    for (const std::size_t i : by_score_) {
      is_kept_[i] = std::none_of(by_score_.begin(), by_score_.end(), [&](std::size_t j) {
        return is_kept_[j] &&
               (iou(gated_[i].box, gated_[j].box) >= options_.suppression_iou || show_one_thing(gated_[i], gated_[j]));
      });
    }
    for (std::size_t i = 0; i < gated_.size(); ++i) {
      if (is_kept_[i]) {
        context_.detections.push_back(gated_[i]);
      } else {
        result->associations[static_cast<std::size_t>(gated_[i].detection_index)].level = AssociationLevel::kSuppressed;
      }
    }
  }

  std::optional<Box> visible_projection(const Track& track, const AssociationContext& context) const {
    if (!track.has_ellipsoid) return std::nullopt;
    const std::optional<Box> box = project_box(track.center_map, track.shape_map, context.P_image_map);
    if (!box) return std::nullopt;
    const Box visible = clip(*box, context.image);
    if (visible.width() <= kMinProjection_px || visible.height() <= kMinProjection_px) return std::nullopt;
    return visible;
  }

  bool is_recent(const Track& track, const Frame& frame) const {
    constexpr std::int64_t kAnswers = 2;  // one missed, however slow the detector
    return track.last_answer >= context_.first_answer &&
           (context_.answer - track.last_answer <= kAnswers ||
            frame.stamp_ns - track.last_stamp_ns <= static_cast<std::int64_t>(options_.memory_s * 1e9));
  }

  /// Indices into context.tracks by detection, kNoTrack for those that start a track.
  std::vector<int> assign(const AssociationContext& context, AssociationFrame* result) {
    if (options_.mode == "joint") return assign_one_to_one(context, score_joint);
    if (options_.mode == "jda") return assign_one_to_one(context, score_jda);
    return cascade(context, result);
  }

  std::vector<int> assign_one_to_one(const AssociationContext& context, AssociationScore score) {
    const auto rows = static_cast<Eigen::Index>(context.detections.size());
    const auto columns = static_cast<Eigen::Index>(context.tracks.size());
    scores_.clear();
    for (const TrackInFrame& track : context.tracks) {
      for (const PreparedDetection& detection : context.detections) scores_.push_back(score(context, track, detection));
    }
    return assign_max(Eigen::Map<const Eigen::MatrixXd>(scores_.data(), rows, columns));
  }

  /// The paper's cascade: each level gives the boxes that the levels before it left over to their best landmark.
  std::vector<int> cascade(const AssociationContext& context, AssociationFrame* result) const {
    std::vector<int> assigned(context.detections.size(), kNoTrack);
    for (const auto& [level, score_of_level] : levels_) {
      for (std::size_t i = 0; i < context.detections.size(); ++i) {
        if (assigned[i] != kNoTrack) continue;
        double best = 0.0;
        for (std::size_t j = 0; j < context.tracks.size(); ++j) {
          const double score = score_of_level(context, context.tracks[j], context.detections[i]);
          if (score > best) {
            best = score;
            assigned[i] = static_cast<int>(j);
          }
        }
        if (assigned[i] != kNoTrack) {
          result->associations[static_cast<std::size_t>(context.detections[i].detection_index)].level = level;
        }
      }
    }
    return assigned;
  }

  void update_tracks(const AssociationContext& context, const std::vector<int>& assigned, AssociationFrame* result) {
    for (std::size_t i = 0; i < assigned.size(); ++i) {
      const PreparedDetection& detection = context.detections[i];
      Association& association = result->associations[static_cast<std::size_t>(detection.detection_index)];
      Track* track = nullptr;
      if (assigned[i] == kNoTrack) {
        track = &tracks_.create(next_id_++);
      } else {
        track = tracks_.find(context.tracks[static_cast<std::size_t>(assigned[i])].track->id);
        if (options_.mode == "joint") association.level = AssociationLevel::kJoint;
        if (options_.mode == "jda") association.level = AssociationLevel::kJda;
      }
      association.near_m = near_m(*track, detection);
      add_observation(*context.frame, detection, track);
      association.landmark_id = track->id;
    }
    for (Association& association : result->associations) {
      if (association.landmark_id >= 0) {
        association.landmark_class_id = tracks_.find(association.landmark_id)->class_id;
      }
    }
  }

  /// Depth of the box's object where it is known: of two that may be it, the one that can be the landmark.
  double near_m(const Track& track, const PreparedDetection& detection) const {
    const Placement* placement = nullptr;
    if (detection.placements.size() == 1) placement = &detection.placements.front();
    if (detection.placements.size() > 1 && track.has_ellipsoid)
      placement = nearest_placement(track, detection).placement;
    const auto axis = context_.P_image_map.row(2);
    return placement ? axis.dot(placement->center.homogeneous()) : 0.0;
  }

  /// What the map never took up, as it does not while the robot only finds itself in it.
  void give_up_unmapped(std::int64_t stamp_ns) {
    if (std::abs(stamp_ns - last_given_up_ns_) < kGiveUpInterval_ns) return;
    last_given_up_ns_ = stamp_ns;
    std::vector<std::int64_t> ids;
    for (const Track* track : tracks_.all()) {
      if (!track->has_ellipsoid && stamp_ns - track->last_stamp_ns > kGiveUpAfter_ns) ids.push_back(track->id);
    }
    for (const std::int64_t id : ids) tracks_.erase(id);
  }

  void add_observation(const Frame& frame, const PreparedDetection& detection, Track* track) {
    track->add_class_weight(detection.class_id, detection.score);
    track->observations += 1;
    track->last_answer = context_.answer;
    track->last_stamp_ns = frame.stamp_ns;
    track->last_keyframe_id = frame.keyframe_id;
    track->last_box = detection.box;
    tracks_.touch(track);
    if (track->has_ellipsoid || !points_) return;
    const std::vector<std::vector<Vec3>> layers = object_layers(*points_, detection.box);
    if (layers.size() != 1) return;
    const SE3 T_map_camera = T_map_odom_ * frame.T_odom_camera;
    track->points_map.clear();
    for (const Vec3& point : layers.front()) track->points_map.push_back(T_map_camera * point);
    tracks_.place(track);
  }

  AssociatorOptions options_;
  std::shared_ptr<const ClassTable> classes_;
  std::vector<std::pair<AssociationLevel, AssociationScore>> levels_;  ///< of the cascade, in order
  TrackStore tracks_;
  std::deque<MergedTrack> merged_tracks_;  ///< in the order they were merged; none of a track that there is
  std::int64_t next_id_ = 0;
  std::uint64_t map_version_ = 0;
  SE3 T_map_odom_;
  std::optional<FramePoints> points_;          ///< of the frame, if it has any and detections
  std::optional<std::int64_t> last_stamp_ns_;  ///< of the answer before
  std::int64_t last_given_up_ns_ = 0;
  double update_us_ = 0.0;  ///< spent on map updates since then

  // Of the frame at hand; kept, so that a frame hardly allocates.
  AssociationContext context_{options_, *classes_};
  std::vector<PreparedDetection> gated_;  ///< before suppression
  std::vector<std::size_t> by_score_;     ///< indices of them
  std::vector<bool> is_kept_;
  std::vector<double> scores_;  ///< detections by tracks, column by column
};

ObjectAssociator::ObjectAssociator(const AssociatorOptions& options, std::shared_ptr<const ClassTable> classes)
    : impl_(new Impl(options, std::move(classes)), [](Impl* impl) { delete impl; }) {}

AssociationFrame ObjectAssociator::associate(const Frame& frame, const std::vector<Detection>& detections) {
  return impl_->associate(frame, detections);
}
AssociationFrame ObjectAssociator::pass(const Frame& frame) {
  AssociationFrame result = impl_->begin(frame);
  result.unanswered = true;
  return result;
}
void ObjectAssociator::count_from(std::int64_t landmark_id) {
  impl_->next_id_ = std::max(impl_->next_id_, landmark_id);
}
bool ObjectAssociator::apply(const MapUpdate& update) { return impl_->apply(update); }
std::uint64_t ObjectAssociator::map_version() const { return impl_->map_version_; }
void ObjectAssociator::set_options(const AssociatorOptions& options) { impl_->options_ = options; }

}  // namespace semantic_topo_loop::core
