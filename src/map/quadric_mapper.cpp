#include "semantic_topo_loop/map/quadric_mapper.h"

#include <algorithm>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include "geometry/depth_points.h"
#include "geometry/statistics.h"
#include "map/landmark_fitter.h"
#include "map/mapped_landmark.h"
#include "map/mapper_state.h"
#include "map/merging.h"
#include "map/motion_blur.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/map/mapper_options.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::size_t kObservationsMax = 1200;  // of a landmark: 0.2 MB; a fit takes mapping.fit_views_max of them
constexpr std::size_t kStillBoxes = 100;        // of one keyframe: a camera that moves has fewer
constexpr double kSeparateBoxesIou = 0.6;       // two boxes that overlap less show two things
constexpr int kRefitsPerFrame = 4;              // after a correction, so that no frame is held up
constexpr double kSureScore = 0.5;              // of a detector, from which on a box counts in full
constexpr double kTurned_rad = 0.2;             // of a correction: half of a bin of SeenFrom, less stays in its bin
constexpr double kUndoReach = 1.5;              // of the distance up to which two landmarks may merge

bool has_depth(const MappedLandmark& landmark) {
  return std::any_of(landmark.observations.begin(), landmark.observations.end(),
                     [](const Observation& observation) { return observation.view.near_m > 0.0; });
}

/// Half of the boxes go, or more: every second one of the keyframe that most are of, again and again, where a camera
/// stood still, which must not crowd out the views from elsewhere; else of all.
void thin(std::vector<Observation>* observations) {
  std::map<std::int64_t, std::size_t> boxes;  // by keyframe
  for (const Observation& observation : *observations) ++boxes[observation.keyframe_id];
  const std::size_t wanted = observations->size() / 2;
  while (observations->size() > wanted) {
    const std::int64_t fullest = with_most(boxes);
    if (boxes[fullest] < kStillBoxes) return halve(observations);
    std::vector<Observation> some;
    bool stays = false;
    for (const Observation& observation : *observations) {
      stays = observation.keyframe_id == fullest ? !stays : stays;
      if (observation.keyframe_id != fullest || stays) some.push_back(observation);
    }
    *observations = std::move(some);
    boxes[fullest] = (boxes[fullest] + 1) / 2;
  }
}

struct Break {
  std::int64_t keyframe_id = -1;  ///< the first after it
  double looked_s = 0.0;          ///< when it was, in the time that somebody looked this session
};

}  // namespace

struct QuadricMapper::Impl {
  Impl(const QuadricMapperOptions& options, std::shared_ptr<const ClassTable> classes)
      : options_(options),
        classes_(std::move(classes)),
        views_(camera_, S_map_keyframe_),
        fitter_(options_, *classes_),
        duplicates_(options_, *classes_) {}

  MapUpdate integrate(const Frame& frame, const AssociationFrame& associations) {
    const Stopwatch stopwatch;
    MapUpdate update = begin_update(frame.frame_id, MapUpdatePhase::kObservation);
    if (frame.is_end) {
      end_frame_id_ = frame.frame_id;
    } else {
      if (frame.is_break || begin_at_) breaks_.push_back({frame.keyframe_id, looked_s_});
      if (begin_at_) T_map_odom_.t = *std::exchange(begin_at_, std::nullopt) - frame.T_odom_camera.t;
      take_camera(frame.camera);
      add_keyframe(frame);
      blur_.push(frame);
      if (!is_fixed_) grow(frame, associations, &update);
    }
    end_update(&update);
    update.duration_us = stopwatch.elapsed_us();
    return update;
  }

  void grow(const Frame& frame, const AssociationFrame& associations, MapUpdate* update) {
    if (!associations.unanswered) look(frame, associations);
    fit_due_landmarks();
    const double since_s = 1e-9 * static_cast<double>(frame.stamp_ns - last_maintenance_ns_);
    if (since_s < options_.maintenance_interval_s) return;
    last_maintenance_ns_ = frame.stamp_ns;
    merge_duplicates(update);
    forget_stale_candidates(update);
  }

  /// Takes in what the detector saw, and what it missed.
  void look(const Frame& frame, const AssociationFrame& associations) {
    const auto keyframe = T_odom_keyframe_.find(frame.keyframe_id);
    if (keyframe == T_odom_keyframe_.end()) return;  // only after a dropped keyframe: nothing to hang the boxes on
    const SE3 T_keyframe_camera = keyframe->second.inverse() * frame.T_odom_camera;
    begin_step(frame.stamp_ns);
    std::optional<FramePoints> points;
    if (frame.points_camera) points.emplace(*frame.points_camera, frame.camera);
    if (!points && associations.associations.empty()) return;  // no box and no depth tell nothing
    add_observations(frame, T_keyframe_camera, points ? &*points : nullptr, associations);
    count_expected(frame, points ? &*points : nullptr, associations);
  }

  MapUpdate apply(const MapCorrection& correction) {
    const Stopwatch stopwatch;
    MapUpdate update = begin_update(correction.frame_id, MapUpdatePhase::kCorrection);
    T_map_odom_ = correction.T_map_odom;
    scale_ = correction.scale;
    if (correction.changed) {
      forget_breaks(correction.loops);
      KeyframePlaces before;  // of those that landmarks move with
      for (const auto& [id, landmark] : landmarks_) {
        const auto anchor = S_map_keyframe_.find(landmark.state.anchor_keyframe_id);
        if (anchor != S_map_keyframe_.end()) before.insert(*anchor);
      }
      for (const KeyframePose& keyframe : correction.keyframes) {
        const auto it = S_map_keyframe_.find(keyframe.keyframe_id);
        if (it != S_map_keyframe_.end()) it->second = Sim3(keyframe.T_map_camera, keyframe.scale);
      }
      for (auto it = S_map_keyframe_.upper_bound(correction.valid_to_keyframe_id); it != S_map_keyframe_.end(); ++it) {
        it->second = Sim3(T_map_odom_ * T_odom_keyframe_.at(it->first), scale_);
      }
      for (auto& [id, landmark] : landmarks_) move(before, &landmark);
      undo_wrong_merges(&update);
      // The map's frame moved even if no landmark did.
      ++map_version_;
    }
    if (correction.frame_id == end_frame_id_ && !is_fixed_) finish(&update);
    end_update(&update);
    update.duration_us = stopwatch.elapsed_us();
    return update;
  }

  MapperState state() const {
    MapperState state;
    state.camera = camera_;
    for (const auto& [id, landmark] : landmarks_) state.landmarks.push_back(landmark);
    state.merges = merge_log_.merges();
    return state;
  }

  MapperDelta take_delta(bool whole) {
    MapperDelta delta;
    delta.is_whole = whole || told_.empty();
    delta.camera = camera_;
    for (const auto& [id, landmark] : landmarks_) {
      const auto told = told_.find(id);
      if (!delta.is_whole && told != told_.end() && !told->second.is_changed) continue;
      LandmarkDelta& changed = delta.changed.emplace_back();
      changed.record = landmark;
      const bool is_anew = delta.is_whole || told == told_.end() || told->second.is_rewritten;
      changed.first = is_anew ? 0 : told->second.observations;
      changed.observations.assign(landmark.observations.begin() + static_cast<std::ptrdiff_t>(changed.first),
                                  landmark.observations.end());
      told_[id] = {landmark.observations.size(), false, false};
    }
    for (auto it = told_.begin(); it != told_.end();) {
      const bool is_gone = landmarks_.count(it->first) == 0;
      if (is_gone && !delta.is_whole) delta.removed.push_back(it->first);
      it = is_gone ? told_.erase(it) : std::next(it);
    }
    merge_log_.take_delta(&delta);
    return delta;
  }

  MapUpdate restore(MapperState state, const std::vector<KeyframePose>& keyframes,
                    const std::optional<Vec3>& begin_at) {
    constexpr double kNowhere_m = 1e6;
    MapUpdate update = begin_update(-1, MapUpdatePhase::kCorrection);
    camera_ = state.camera;
    merge_log_.restore(state.merges);
    begin_at_ = begin_at;
    if (begin_at_) T_map_odom_.t = *begin_at_;
    for (const KeyframePose& keyframe : keyframes) {
      T_odom_keyframe_[keyframe.keyframe_id] = keyframe.T_map_camera;
      S_map_keyframe_[keyframe.keyframe_id] = Sim3(keyframe.T_map_camera, keyframe.scale);
    }
    const std::int64_t map_end_ns = keyframes.empty() ? 0 : keyframes.back().stamp_ns;
    forget_gone_neighbours(&state.landmarks);
    for (MappedLandmark& landmark : state.landmarks) {
      landmark.seen_at_s = -1e-9 * static_cast<double>(std::max<std::int64_t>(0, map_end_ns - landmark.last_stamp_ns));
      changed_.insert(landmark.state.id);
      landmark.was_confirmed = landmark.state.state == LandmarkState::kConfirmed;
      if (landmark.state.state == LandmarkState::kRetired) {
        left_before_.insert(landmark.state.id);
      } else {
        landmark.sightings.seen_through_since_s = 0.0;  // or it would be gone where nobody looks
      }
      // Merges are settled, and the ids of what went in them are given out again.
      for (Observation& observation : landmark.observations) observation.source_id = landmark.state.id;
      landmarks_[landmark.state.id] = std::move(landmark);
    }
    end_update(&update);
    // Until a frame tells where the odometry is, none of the map is in its view.
    if (begin_at_) update.T_map_odom.t.x() = kNowhere_m;
    return update;
  }

  /// Where a loop leads over a break, a correction has told how its two sides lie.
  void forget_breaks(const std::vector<LoopVerdict>& loops) {
    const auto is_joined = [&loops](const Break& b) {
      return std::any_of(loops.begin(), loops.end(), [&b](const LoopVerdict& loop) {
        const auto [first, last] = std::minmax(loop.match_keyframe_id, loop.query_keyframe_id);
        return loop.kept && first < b.keyframe_id && b.keyframe_id <= last;
      });
    };
    breaks_.erase(std::remove_if(breaks_.begin(), breaks_.end(), is_joined), breaks_.end());
  }

  /// Boxes are kept in the pixels of one camera.
  void take_camera(const Camera& camera) {
    for (auto& [id, landmark] : landmarks_) {
      if (!move_boxes(camera_, camera, &landmark)) break;
      note_rewritten(id);
    }
    camera_ = camera;
  }

  /// To be told by take_delta, with all its observations.
  void note_rewritten(std::int64_t id) {
    const auto told = told_.find(id);
    if (told != told_.end()) told->second.is_changed = told->second.is_rewritten = true;
  }
  void note_changed(std::int64_t id) {
    const auto told = told_.find(id);
    if (told != told_.end()) told->second.is_changed = true;
  }

  /// How much time this answer stands for; long gaps count no more than a slow detector's interval.
  void begin_step(std::int64_t stamp_ns) {
    const double since_s = last_stamp_ns_ ? 1e-9 * static_cast<double>(stamp_ns - *last_stamp_ns_) : 0.0;
    step_s_ = std::clamp(since_s, 0.0, kStepMax_s);
    if (!last_stamp_ns_ || stamp_ns < last_maintenance_ns_) last_maintenance_ns_ = stamp_ns;
    looked_s_ += step_s_;
    last_stamp_ns_ = stamp_ns;
  }

  MapUpdate begin_update(std::int64_t frame_id, MapUpdatePhase phase) {
    changed_.clear();
    touched_.clear();
    MapUpdate update;
    update.frame_id = frame_id;
    update.phase = phase;
    update.base_version = map_version_;
    return update;
  }

  void end_update(MapUpdate* update) {
    touched_.insert(changed_.begin(), changed_.end());
    if (!is_fixed_ && std::exchange(has_new_options_, false)) {
      for (const auto& [id, landmark] : landmarks_) touched_.insert(id);
    }
    for (const std::int64_t id : touched_) {
      note_changed(id);
      const auto it = landmarks_.find(id);
      if (it == landmarks_.end()) continue;
      Landmark& landmark = it->second.state;
      const LandmarkState state = state_of(it->second);
      if (state == landmark.state && changed_.count(id) == 0) continue;
      landmark.state = state;
      landmark.quality = landmark_quality(it->second);
      update->changed.push_back(landmark);
    }
    const bool is_new =
        !update->changed.empty() || !update->removed.empty() || !update->merged.empty() || !update->unmerged.empty();
    if (is_new && update->base_version == map_version_) ++map_version_;
    update->map_version = map_version_;
    update->T_map_odom = T_map_odom_;
  }

  LandmarkState state_of(const MappedLandmark& landmark) const {
    const LandmarkState state = life_cycle_state(landmark, options_, is_movable(landmark.state.class_id));
    const bool is_piece = state == LandmarkState::kConfirmed && !landmark.sightings.is_placed() &&
                          landmark.sightings.whole_s < options_.confirm_seen_s && touches_confirmed(landmark);
    return is_piece ? LandmarkState::kCandidate : state;
  }

  /// What was always cut may be a piece of an object that it reaches into.
  bool touches_confirmed(const MappedLandmark& landmark) const {
    return std::any_of(landmarks_.begin(), landmarks_.end(), [&](const auto& entry) {
      const Landmark& other = entry.second.state;
      return other.state == LandmarkState::kConfirmed && duplicates_.may_be_pieces(other, landmark.state);
    });
  }

  bool is_movable(int class_id) const {
    const ObjectClass* object_class = classes_->find(class_id);
    return object_class == nullptr || object_class->role == ClassRole::kMovable;
  }

  void add_keyframe(const Frame& frame) {
    if (!frame.is_keyframe) return;
    T_odom_keyframe_[frame.keyframe_id] = frame.T_odom_camera;
    S_map_keyframe_[frame.keyframe_id] = Sim3(T_map_odom_ * frame.T_odom_camera, scale_);
  }

  void add_observations(const Frame& frame, const SE3& T_keyframe_camera, const FramePoints* points,
                        const AssociationFrame& associations) {
    for (const Association& association : associations.associations) {
      if (association.landmark_id < 0) continue;
      const std::int64_t id = merges_.resolve(association.landmark_id);
      MappedLandmark& landmark = landmarks_[id];
      if (landmark.state.id < 0) {
        landmark.state.id = id;
        landmark.next_fit_at = options_.min_views;
      }
      count_seen(association, points != nullptr, &landmark.sightings);
      if (association.truncated != 0) landmark.sightings.views.add(frame.keyframe_id, true);
      if (association.has_depth() && !landmark.state.ellipsoid && !has_depth(landmark)) landmark.next_fit_at = 1;
      const int hidden = points != nullptr ? hidden_sides(*points, association.box) : 0;
      const auto truncated = static_cast<std::uint8_t>(association.truncated | hidden);
      landmark.observations.push_back(
          {frame.frame_id,
           association.landmark_id,
           frame.keyframe_id,
           association.class_id,
           {T_keyframe_camera, association.box, truncated, association.has_depth() ? association.near_m : 0.0}});
      if (landmark.observations.size() > kObservationsMax) {
        thin(&landmark.observations);
        note_rewritten(id);
      }
      landmark.state.class_id = association.landmark_class_id;
      landmark.state.observations += 1;
      landmark.state.count_class(association.class_id);
      landmark.last_stamp_ns = frame.stamp_ns;
      landmark.seen_at_s = looked_s_;
      changed_.insert(id);
    }
    count_side_by_side(associations);
  }

  void count_seen(const Association& association, bool has_points, Sightings* sightings) const {
    const double seen_s = has_points ? step_s_ * std::min(1.0, association.score / kSureScore) : step_s_;
    sightings->seen_s += seen_s;
    if (association.truncated == 0) sightings->whole_s += seen_s;
    if (association.has_depth()) sightings->placed_s += seen_s;
    for (int side = 0; side < 4; ++side) {
      if ((association.truncated & (1 << side)) == 0) sightings->bounded_s(side) += seen_s;
    }
    sightings->missed_since_s = 0.0;
    sightings->seen_through_since_s = 0.0;
  }

  void count_expected(const Frame& frame, const FramePoints* points, const AssociationFrame& associations) {
    const SE3 T_map_camera = T_map_odom_ * frame.T_odom_camera;
    for (const ExpectedLandmark& expected : expected_landmarks(landmarks_, frame, points, T_map_camera, associations)) {
      MappedLandmark& landmark = landmarks_.at(expected.id);
      // Where the camera is to what it saw before a break is not known.
      if (!breaks_.empty() && landmark.seen_at_s <= breaks_.back().looked_s) continue;
      const Vec3 direction = landmark.state.ellipsoid->center() - T_map_camera.t;
      // A box that is missing in a blurred image tells little, and nothing where nothing at all was detected: that is
      // rather the detector's fault. Depth tells as much as ever.
      const double recall = associations.associations.empty()
                                ? 0.0
                                : blur_.recall(T_map_camera.inverse() * landmark.state.ellipsoid->center());
      const bool is_boxed = landmark.last_stamp_ns == frame.stamp_ns;
      // What depth placed from nearby may never have been looked at from where the detector still finds it.
      const bool is_too_small =
          points != nullptr && !is_boxed && landmark.seen_from.is_smaller_than_ever(expected.size_px);
      const double expected_s = is_too_small ? 0.0 : recall * step_s_;
      landmark.sightings.expected_s += expected_s;
      const double seen_through_s = expected.is_seen_through ? step_s_ : 0.0;
      if (is_boxed) {
        landmark.seen_from.add(direction, expected.size_px);
        landmark.sightings.familiar_seen_s += expected_s;
        landmark.sightings.views.add(frame.keyframe_id, true);
        if (expected.is_seen_into) {
          landmark.sightings.hollow_s += expected_s;
        } else {
          landmark.sightings.transparent_s += seen_through_s;
        }
      } else {
        landmark.sightings.seen_through_since_s += seen_through_s;
        if (recall > 0.5 && !is_too_small) landmark.sightings.views.add(frame.keyframe_id, false);
        if (landmark.seen_from.covers(direction, expected.size_px)) {
          landmark.sightings.familiar_missed_s += expected_s;
          landmark.sightings.missed_since_s += expected_s;
        }
      }
      touched_.insert(expected.id);
    }
  }

  void count_side_by_side(const AssociationFrame& frame) {
    for (std::size_t i = 0; i < frame.associations.size(); ++i) {
      const Association& a = frame.associations[i];
      if (a.landmark_id < 0) continue;
      const std::int64_t id_a = merges_.resolve(a.landmark_id);
      for (std::size_t j = 0; j < i; ++j) {
        const Association& b = frame.associations[j];
        if (b.landmark_id < 0) continue;
        const std::int64_t id_b = merges_.resolve(b.landmark_id);
        if (id_a == id_b || iou(a.box, b.box) >= kSeparateBoxesIou) continue;
        landmarks_.at(id_a).seen_beside[id_b] += 1;
        landmarks_.at(id_b).seen_beside[id_a] += 1;
      }
    }
  }

  void fit_due_landmarks() {
    for (const std::int64_t id : changed_) {
      MappedLandmark& landmark = landmarks_.at(id);
      if (landmark.state.observations >= landmark.next_fit_at) fit(&landmark);
    }
    for (int refits = 0; refits < kRefitsPerFrame && !fit_due_.empty();) {
      const auto found = landmarks_.find(*fit_due_.begin());
      fit_due_.erase(fit_due_.begin());
      if (found == landmarks_.end()) continue;
      fit(&found->second);
      ++refits;
    }
  }

  /// Those that went unseen until the last answer: while nobody looks, as between two sessions, none grows older.
  void forget_stale_candidates(MapUpdate* update) {
    for (auto next = landmarks_.begin(); next != landmarks_.end();) {
      const auto& [id, landmark] = *next++;
      const double unseen_s = looked_s_ - landmark.seen_at_s;
      const bool is_short = landmark.sightings.seen_s < options_.forget_candidate_seen_s;
      // Retired, but never an object: what was carried through the view, say.
      const bool is_candidate =
          landmark.state.state == LandmarkState::kCandidate ||
          (landmark.state.state == LandmarkState::kRetired && landmark.sightings.seen_s < options_.confirm_seen_s);
      const bool is_stale = (is_short && unseen_s > options_.forget_candidate_s) ||
                            (is_candidate && unseen_s > options_.forget_unconfirmed_s);
      // What the session before had as an object may be unseen for days, and is to be found gone.
      if (is_stale && !landmark.was_confirmed) remove(id, update);
    }
  }

  void remove(std::int64_t id, MapUpdate* update) {
    for (const auto& [other, frames] : landmarks_.at(id).seen_beside) {
      const auto neighbour = landmarks_.find(other);
      if (neighbour == landmarks_.end()) continue;
      neighbour->second.seen_beside.erase(id);
      note_changed(other);
    }
    landmarks_.erase(id);
    note_rewritten(id);
    update->removed.push_back(id);
  }

  /// Landmarks with an ellipsoid, most observed first. @param with_retired those, too, that this session gave up
  std::vector<std::int64_t> by_observations(bool with_retired) const {
    std::vector<std::int64_t> ids;
    for (const auto& [id, landmark] : landmarks_) {
      const bool has_left =
          landmark.state.state == LandmarkState::kRetired && (!with_retired || left_before_.count(id) != 0);
      if (landmark.state.mean_iou > 0.0 && !has_left) ids.push_back(id);
    }
    std::stable_sort(ids.begin(), ids.end(), [this](std::int64_t a, std::int64_t b) {
      return landmarks_.at(a).state.observations > landmarks_.at(b).state.observations;
    });
    return ids;
  }

  void merge_duplicates(MapUpdate* update) {
    if (!options_.merge_duplicates) return;
    const std::vector<std::int64_t> ids = by_observations(true);
    std::vector<std::pair<double, std::size_t>> along_x;  // centres, with the index of the id
    double largest_m = 0.0;
    for (std::size_t i = 0; i < ids.size(); ++i) {
      const Ellipsoid& ellipsoid = *landmarks_.at(ids[i]).state.ellipsoid;
      along_x.emplace_back(ellipsoid.center().x(), i);
      largest_m = std::max(largest_m, ellipsoid.semi_axes.maxCoeff());
    }
    std::sort(along_x.begin(), along_x.end());
    for (std::size_t i = 0; i < ids.size(); ++i) {
      // A merge moves the survivor: what comes after is looked for about its new place.
      for (std::optional<std::size_t> j = i; j && landmarks_.count(ids[i]) != 0;) {
        j = next_duplicate(ids, i, *j + 1, along_x, largest_m);
        if (j) merge(ids[i], ids[*j], update);
      }
    }
  }

  /// The first landmark from `begin` on that is the same object as the i-th.
  std::optional<std::size_t> next_duplicate(const std::vector<std::int64_t>& ids, std::size_t i, std::size_t begin,
                                            const std::vector<std::pair<double, std::size_t>>& along_x,
                                            double largest_m) const {
    constexpr double kRounding_m = 1e-6;
    const MappedLandmark& landmark = landmarks_.at(ids[i]);
    const double x = landmark.state.ellipsoid->center().x();
    const double reach_m =
        DuplicateTest::reach_m(landmark.state.ellipsoid->semi_axes.maxCoeff(), largest_m) + kRounding_m;
    std::vector<std::size_t> near;
    for (auto it = std::lower_bound(along_x.begin(), along_x.end(), std::pair(x - reach_m, std::size_t{0}));
         it != along_x.end() && it->first <= x + reach_m; ++it) {
      if (it->second >= begin) near.push_back(it->second);
    }
    std::sort(near.begin(), near.end());
    const auto found = std::find_if(near.begin(), near.end(), [&](std::size_t j) {
      const auto other = landmarks_.find(ids[j]);
      if (other == landmarks_.end()) return false;
      // Of what was retired from a wrong pose, only what surely is an object shows that it is there.
      const LandmarkState a = landmark.state.state, b = other->second.state.state;
      const bool has_left = a == LandmarkState::kRetired || b == LandmarkState::kRetired;
      const bool is_there = a == LandmarkState::kConfirmed || b == LandmarkState::kConfirmed;
      return (!has_left || is_there) && duplicates_.is_duplicate(landmark, other->second, views_);
    });
    return found == near.end() ? std::nullopt : std::optional(*found);
  }

  void merge(std::int64_t survivor_id, std::int64_t merged_id, MapUpdate* update) {
    MappedLandmark& survivor = landmarks_.at(survivor_id);
    const Landmark& merged = landmarks_.at(merged_id).state;
    merge_log_.add({0,
                    {merged_id, survivor_id},
                    merged.class_id,
                    merged.observations,
                    update->frame_id,
                    last_stamp_ns_.value_or(survivor.last_stamp_ns),
                    std::nullopt});
    merges_.join(S_map_keyframe_, std::move(landmarks_.at(merged_id)), &survivor);
    landmarks_.erase(merged_id);
    for (const std::int64_t id : {merged_id, survivor_id}) note_rewritten(id);
    update->merged.push_back({merged_id, survivor_id});
    while (survivor.observations.size() > kObservationsMax) thin(&survivor.observations);
    changed_.insert(survivor_id);
    fit(&survivor);
  }

  /// Takes back the merges whose two parts a correction has pulled apart, the last made first.
  void undo_wrong_merges(MapUpdate* update) {
    for (std::size_t i = merges_.records().size(); i-- > 0;) {
      const MergeRecord& record = merges_.records()[i];
      const auto merged = MergeHistory::place(S_map_keyframe_, record.merged);
      const auto survivor = MergeHistory::place(S_map_keyframe_, record.survivor);
      // The survivor may have gone into another one since.
      const std::int64_t holder_id = merges_.resolve(record.merge.survivor_id);
      const auto holder = landmarks_.find(holder_id);
      if (!merged || !survivor || holder == landmarks_.end()) continue;
      const double apart = (merged->center() - survivor->center()).norm();
      if (apart <= kUndoReach * DuplicateTest::reach_m(merged->semi_axes.maxCoeff(), survivor->semi_axes.maxCoeff()))
        continue;
      const LandmarkMerge merge = record.merge;
      landmarks_[merge.merged_id] = merges_.split(S_map_keyframe_, i, &holder->second);
      update->unmerged.push_back(merge);
      merge_log_.take_back(merge, update->frame_id);
      for (const std::int64_t id : {merge.merged_id, holder_id}) note_rewritten(id);
      changed_.insert({merge.merged_id, holder_id});
      // They were fitted in the map that has just been corrected.
      for (const std::int64_t id : {merge.merged_id, holder_id}) {
        if (landmarks_.at(id).state.mean_iou > 0.0) fit_due_.insert(id);
      }
    }
  }

  /// With the anchor keyframe, in its scale; the fit from all corrected views follows in the next frames.
  void move(const KeyframePlaces& before, MappedLandmark* landmark) {
    if (!landmark->state.ellipsoid) return;
    const auto old_pose = before.find(landmark->state.anchor_keyframe_id);
    if (old_pose == before.end()) return;
    const Sim3 S_new_old = S_map_keyframe_.at(landmark->state.anchor_keyframe_id) * old_pose->second.inverse();
    landmark->state.ellipsoid->T_world_quadric = S_new_old.pose(landmark->state.ellipsoid->T_world_quadric);
    landmark->state.ellipsoid->semi_axes *= S_new_old.scale;
    const Mat3 by_old = S_new_old.scale * S_new_old.T.q.toRotationMatrix();
    landmark->state.center_covariance = by_old * landmark->state.center_covariance * by_old.transpose();
    if (rotation_angle(S_new_old.T.q, Quaternion::Identity()) > kTurned_rad) landmark->seen_from.turn(S_new_old.T.q);
    if (landmark->state.mean_iou > 0.0) fit_due_.insert(landmark->state.id);
    changed_.insert(landmark->state.id);
  }

  /// At the end of a stream: every landmark fitted on all its views, duplicates and parts gone.
  void finish(MapUpdate* update) {
    for (auto& [id, landmark] : landmarks_) fit(&landmark);
    constexpr int kRounds = 3;  // a merge moves the survivor, which may uncover another duplicate
    for (int round = 0; round < kRounds; ++round) merge_duplicates(update);
    remove_parts(update);
  }

  /// Parts of an object that the detector boxed alone for a while.
  void remove_parts(MapUpdate* update) {
    if (!options_.merge_duplicates) return;
    const std::vector<std::int64_t> ids = by_observations(false);
    for (std::size_t i = 0; i < ids.size(); ++i) {
      for (std::size_t j = i + 1; j < ids.size(); ++j) {
        if (landmarks_.count(ids[i]) == 0 || landmarks_.count(ids[j]) == 0) continue;
        const MappedLandmark &whole = landmarks_.at(ids[i]), &part = landmarks_.at(ids[j]);
        const bool is_surer =
            state_of(part) == LandmarkState::kConfirmed && state_of(whole) != LandmarkState::kConfirmed;
        // What an earlier session had as an object is to be found gone.
        if (!is_surer && !part.was_confirmed && duplicates_.is_part(whole, part, views_)) remove(ids[j], update);
      }
    }
  }

  void fit(MappedLandmark* landmark) {
    fit_due_.erase(landmark->state.id);
    note_changed(landmark->state.id);
    if (fitter_.fit(views_, landmark)) changed_.insert(landmark->state.id);
  }

  QuadricMapperOptions options_;
  bool has_new_options_ = false;  ///< by which the landmarks were not judged yet
  std::shared_ptr<const ClassTable> classes_;
  Camera camera_;
  SE3 T_map_odom_;
  std::optional<Vec3> begin_at_;  ///< where the first camera is to stand, until it comes
  double scale_ = 1.0;            ///< units of length of the map in one of the odometry, now
  KeyframePlaces S_map_keyframe_;
  std::map<std::int64_t, SE3> T_odom_keyframe_;
  std::map<std::int64_t, MappedLandmark> landmarks_;
  std::set<std::int64_t> left_before_;  ///< retired by an earlier session: what comes back is new
  MergeHistory merges_;
  MergeLog merge_log_;
  ViewSource views_;
  LandmarkFitter fitter_;
  DuplicateTest duplicates_;
  std::optional<std::int64_t> last_stamp_ns_;  ///< of the answer before
  double looked_s_ = 0.0;                      ///< of this session, the time that its answers stand for
  std::int64_t last_maintenance_ns_ = 0;
  std::vector<Break> breaks_;  ///< of the odometry, which no loop leads over; the session's begin is one
  bool is_fixed_ = false;
  double step_s_ = 0.0;  ///< the time that this answer stands for
  MotionBlur blur_;
  /// Of a landmark that take_delta told of: how many of its observations, and whether they, or anything, is other now.
  struct Told {
    std::size_t observations = 0;
    bool is_changed = false, is_rewritten = false;
  };
  std::map<std::int64_t, Told> told_;
  std::uint64_t map_version_ = 0;
  std::optional<std::int64_t> end_frame_id_;  ///< of the end frame, whose correction finishes the map
  std::set<std::int64_t> fit_due_;            ///< a correction moved their views
  std::set<std::int64_t> changed_;            ///< by the update being made: to be published
  std::set<std::int64_t> touched_;            ///< to be published if the state changed
};

QuadricMapper::QuadricMapper(const QuadricMapperOptions& options, std::shared_ptr<const ClassTable> classes)
    : impl_(new Impl(options, std::move(classes)), [](Impl* impl) { delete impl; }) {}

MapUpdate QuadricMapper::integrate(const Frame& frame, const AssociationFrame& associations) {
  return impl_->integrate(frame, associations);
}
MapUpdate QuadricMapper::apply(const MapCorrection& correction) { return impl_->apply(correction); }
MapperState QuadricMapper::state() const { return impl_->state(); }
MapperDelta QuadricMapper::take_delta(bool whole) { return impl_->take_delta(whole); }
MapUpdate QuadricMapper::restore(MapperState state, const std::vector<KeyframePose>& keyframes,
                                 const std::optional<Vec3>& begin_at) {
  return impl_->restore(std::move(state), keyframes, begin_at);
}
std::vector<Landmark> QuadricMapper::landmarks() const {
  std::vector<Landmark> landmarks;
  landmarks.reserve(impl_->landmarks_.size());
  for (const auto& [id, landmark] : impl_->landmarks_) landmarks.push_back(landmark.state);
  return landmarks;
}
std::optional<std::int64_t> QuadricMapper::last_seen_ns(std::int64_t landmark_id) const {
  const auto found = impl_->landmarks_.find(landmark_id);
  return found == impl_->landmarks_.end() ? std::nullopt : std::optional(found->second.last_stamp_ns);
}
void QuadricMapper::set_fixed(bool fixed) { impl_->is_fixed_ = fixed; }
void QuadricMapper::set_options(const QuadricMapperOptions& options) {
  impl_->options_ = options;
  impl_->has_new_options_ = true;
}
std::uint64_t QuadricMapper::map_version() const { return impl_->map_version_; }
const SE3& QuadricMapper::T_map_odom() const { return impl_->T_map_odom_; }

}  // namespace semantic_topo_loop::core
