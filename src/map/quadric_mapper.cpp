#include "semantic_topo_loop/map/quadric_mapper.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <sstream>

#include "semantic_topo_loop/geometry/statistics.h"
#include "semantic_topo_loop/map/mapper_options.h"
#include "semantic_topo_loop/map/object_points.h"
#include "semantic_topo_loop/map/quadric_fit.h"
#include "semantic_topo_loop/map/quadric_initialisation.h"
#include "semantic_topo_loop/pipeline/stopwatch.h"

namespace semantic_topo_loop::core {
namespace {

/// A box of a landmark, hung on the keyframe of its frame so that it follows corrections.
struct Observation {
  std::int64_t frame_id = -1;
  std::int64_t keyframe_id = -1;
  SE3 T_keyframe_camera;
  Box box;
  std::uint8_t truncated = 0;
  int class_id = -1;
};

struct MappedLandmark {
  Landmark state;
  std::vector<Observation> observations;    ///< bounded: thinned evenly when they exceed kObservationsMax
  std::map<std::int64_t, int> seen_beside;  ///< frames in which another landmark had a separate box
  std::int64_t last_stamp_ns = 0;
  int expected_frames = 0;
  int next_fit_at = 0;
  bool fit_due = false;  ///< a correction moved its views
};

constexpr std::size_t kObservationsMax = 1200;
constexpr double kSeparateBoxesIou = 0.6;  // two boxes that overlap less show two things
constexpr std::size_t kMergeViews = 30;            // boxes that vote on a merge
constexpr int kRefitsPerFrame = 4;         // after a correction, so that no frame is held up
constexpr double kMinExpectedWidthPx = 12.0, kMinExpectedHeightPx = 8.0;
constexpr double kFullyVisibleShare = 0.8;

/// Up to n elements, evenly spread, first and last included.
template <class T>
std::vector<T> spread(const std::vector<T>& values, std::size_t count) {
  if (values.size() <= count) return values;
  std::vector<T> result;
  result.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    result.push_back(values[count == 1 ? values.size() / 2 : i * (values.size() - 1) / (count - 1)]);
  }
  return result;
}

/// rho = mean IoU * (1 - e^(-baseline / 15 deg)) * (1 - e^(-views / 20)) / (1 + sigma / 5 cm), with sigma the root mean
/// variance of the centre: 1 for an object well seen from all around, 0 for a guess.
double landmark_quality(const Landmark& landmark) {
  const double sigma = std::sqrt(std::max(0.0, landmark.center_covariance.trace() / 3.0));
  return landmark.mean_iou * (1.0 - std::exp(-landmark.baseline_deg / 15.0)) *
         (1.0 - std::exp(-landmark.observations / 20.0)) / (1.0 + sigma / 0.05);
}

}  // namespace

bool QuadricMapperOptions::is_valid(std::string* error) const {
  const auto fail = [error](const char* name, double value, const char* rule) {
    std::ostringstream message;
    message << "parameter 'mapping." << name << "' = " << value << " must be " << rule;
    if (error != nullptr) *error = message.str();
    return false;
  };
  if (min_views < 3) return fail("min_views", min_views, ">= 3");
  if (fit_views_max < min_views) return fail("fit_views_max", fit_views_max, ">= mapping.min_views");
  if (confirm_views < min_views) return fail("confirm_views", confirm_views, ">= mapping.min_views");
  if (maintenance_interval_frames < 1) return fail("maintenance_interval_frames", maintenance_interval_frames, ">= 1");
  if (forget_candidate_views < 0) return fail("forget_candidate_views", forget_candidate_views, ">= 0");
  if (retire_expected_frames < 1) return fail("retire_expected_frames", retire_expected_frames, ">= 1");
  for (const auto& [name, value] :
       {std::pair("refit_growth", refit_growth), std::pair("max_depth_m", max_depth_m),
        std::pair("max_semi_axis_m", max_semi_axis_m), std::pair("forget_candidate_s", forget_candidate_s)}) {
    if (!(value > 0.0)) return fail(name, value, "> 0");
  }
  for (const auto& [name, value] :
       {std::pair("min_baseline_deg", min_baseline_deg), std::pair("confirm_baseline_deg", confirm_baseline_deg)}) {
    if (!(value >= 0.0 && value < 180.0)) return fail(name, value, "in [0, 180)");
  }
  for (const auto& [name, value] :
       {std::pair("min_fit_iou", min_fit_iou), std::pair("merge_iou", merge_iou),
        std::pair("merge_iou_confusable", merge_iou_confusable), std::pair("merge_veto_share", merge_veto_share),
        std::pair("confirm_mean_iou", confirm_mean_iou), std::pair("confirm_seen_share", confirm_seen_share),
        std::pair("retire_seen_share", retire_seen_share)}) {
    if (!(value >= 0.0 && value <= 1.0)) return fail(name, value, "in [0, 1]");
  }
  return true;
}

class QuadricMapper::Impl {
 public:
  Impl(const QuadricMapperOptions& options, std::shared_ptr<const ClassTable> classes)
      : options_(options), classes_(std::move(classes)) {}

  MapUpdate integrate(const Frame& frame, const AssociationFrame& associations) {
    const Stopwatch stopwatch;
    MapUpdate update = begin_update(frame.frame_id, MapUpdatePhase::kObservation);
    if (frame.is_end) {
      finishing_ = true;  // the last correction comes first
    } else {
      camera_ = frame.camera;
      add_keyframe(frame);
      add_observations(frame, associations);
      count_expected(frame, associations);
      fit_due_landmarks();
      if ((frame.frame_id + 1) % options_.maintenance_interval_frames == 0) maintain(frame.stamp_ns, &update);
    }
    end_update(&update);
    update.duration_us = stopwatch.elapsed_us();
    return update;
  }

  MapUpdate apply(const MapCorrection& correction) {
    const Stopwatch stopwatch;
    MapUpdate update = begin_update(correction.frame_id, MapUpdatePhase::kCorrection);
    if (correction.changed) {
      const std::map<std::int64_t, SE3> before = T_map_keyframe_;
      T_map_odom_ = correction.T_map_odom;
      for (const KeyframePose& keyframe : correction.keyframes) {
        const auto it = T_map_keyframe_.find(keyframe.keyframe_id);
        if (it != T_map_keyframe_.end()) it->second = keyframe.T_map_camera;
      }
      for (auto it = T_map_keyframe_.upper_bound(correction.valid_to_keyframe_id); it != T_map_keyframe_.end(); ++it) {
        it->second = T_map_odom_ * T_odom_keyframe_.at(it->first);
      }
      for (auto& [id, landmark] : landmarks_) move(before, &landmark);
      // The map's frame moved even if no landmark did.
      update.map_version = ++map_version_;
    }
    if (finishing_) finish(&update);
    end_update(&update);
    update.duration_us = stopwatch.elapsed_us();
    return update;
  }

  std::vector<Landmark> landmarks() const {
    std::vector<Landmark> result;
    result.reserve(landmarks_.size());
    for (const auto& [id, landmark] : landmarks_) result.push_back(landmark.state);
    return result;
  }

  std::uint64_t map_version() const { return map_version_; }
  const SE3& T_map_odom() const { return T_map_odom_; }

 private:
  using Landmarks = std::map<std::int64_t, MappedLandmark>;

  MapUpdate begin_update(std::int64_t frame_id, MapUpdatePhase phase) {
    changed_.clear();
    MapUpdate update;
    update.frame_id = frame_id;
    update.phase = phase;
    update.base_version = map_version_;
    update.map_version = map_version_;
    return update;
  }

  void end_update(MapUpdate* update) {
    for (const std::int64_t id : changed_) {
      const auto it = landmarks_.find(id);
      if (it == landmarks_.end()) continue;
      update_state(&it->second);
      update->changed.push_back(it->second.state);
    }
    const bool is_new = !update->changed.empty() || !update->removed.empty() || !update->merged.empty();
    if (is_new && update->map_version == map_version_ && update->base_version == map_version_) ++map_version_;
    update->map_version = map_version_;
    update->T_map_odom = T_map_odom_;
  }

  void add_keyframe(const Frame& frame) {
    if (!frame.is_keyframe) return;
    T_odom_keyframe_[frame.keyframe_id] = frame.T_odom_camera;
    T_map_keyframe_[frame.keyframe_id] = T_map_odom_ * frame.T_odom_camera;
  }

  /// The landmark that an id has become by merges.
  std::int64_t resolve(std::int64_t id) const {
    for (auto it = redirects_.find(id); it != redirects_.end(); it = redirects_.find(id)) id = it->second;
    return id;
  }

  void add_observations(const Frame& frame, const AssociationFrame& associations) {
    const auto keyframe = T_odom_keyframe_.find(frame.keyframe_id);
    if (keyframe == T_odom_keyframe_.end()) return;  // only after a dropped keyframe: nothing to hang the boxes on
    const SE3 T_keyframe_camera = keyframe->second.inverse() * frame.T_odom_camera;
    for (const Association& association : associations.associations) {
      if (association.landmark_id < 0) continue;
      const std::int64_t id = resolve(association.landmark_id);
      MappedLandmark& landmark = landmarks_[id];
      if (landmark.state.id < 0) {
        landmark.state.id = id;
        landmark.next_fit_at = options_.min_views;
        initialise_from_frame_points(frame, association, &landmark);
      }
      landmark.observations.push_back({frame.frame_id, frame.keyframe_id, T_keyframe_camera, association.box,
                                       association.truncated, association.class_id});
      if (landmark.observations.size() > kObservationsMax) thin(&landmark.observations);
      landmark.state.class_id = association.landmark_class_id;
      landmark.state.observations += 1;
      landmark.last_stamp_ns = frame.stamp_ns;
      changed_.insert(id);
    }
    count_side_by_side(associations);
  }

  void initialise_from_frame_points(const Frame& frame, const Association& association,
                                    MappedLandmark* landmark) const {
    if (!frame.points_camera || association.truncated != 0) return;
    const BoxView view{T_map_odom_ * frame.T_odom_camera, association.box, association.truncated};
    landmark->state.ellipsoid =
        initialise_from_points(frame.camera, view, object_points(*frame.points_camera, frame.camera, association.box));
    landmark->state.anchor_keyframe_id = frame.keyframe_id;
  }

  static void thin(std::vector<Observation>* observations) {
    std::vector<Observation> kept;
    kept.reserve(observations->size() / 2 + 1);
    for (std::size_t i = 0; i < observations->size(); i += 2) kept.push_back((*observations)[i]);
    *observations = std::move(kept);
  }

  void count_side_by_side(const AssociationFrame& frame) {
    for (std::size_t i = 0; i < frame.associations.size(); ++i) {
      const Association& a = frame.associations[i];
      if (a.landmark_id < 0) continue;
      const std::int64_t id_a = resolve(a.landmark_id);
      for (std::size_t j = 0; j < i; ++j) {
        const Association& b = frame.associations[j];
        if (b.landmark_id < 0) continue;
        const std::int64_t id_b = resolve(b.landmark_id);
        if (id_a == id_b || iou(a.box, b.box) >= kSeparateBoxesIou) continue;
        landmarks_.at(id_a).seen_beside[id_b] += 1;
        landmarks_.at(id_b).seen_beside[id_a] += 1;
      }
    }
  }

  /// In which frames a landmark should have been detected: fully in view and large enough.
  void count_expected(const Frame& frame, const AssociationFrame& associations) {
    if (associations.associations.empty()) return;
    const Mat34 P = projection_matrix(frame.camera, T_map_odom_ * frame.T_odom_camera);
    for (auto& [id, landmark] : landmarks_) {
      if (!landmark.state.ellipsoid) continue;
      const std::optional<Box> box = project_box(*landmark.state.ellipsoid, P);
      if (!box) continue;
      const Box visible = clip(*box, frame.camera.width, frame.camera.height);
      if (visible.area() <= kFullyVisibleShare * box->area() || visible.width() <= kMinExpectedWidthPx ||
          visible.height() <= kMinExpectedHeightPx) {
        continue;
      }
      landmark.expected_frames += 1;
      changed_.insert(id);
    }
  }

  /// The views that take part in a fit: boxes of the landmark's class or one confused with it, whole ones first; what
  /// the image border cuts fills up, since of a large object seen from near there may be nothing else.
  std::vector<BoxView> fit_views(const MappedLandmark& landmark) const {
    std::vector<Observation> whole, cut;
    for (const Observation& observation : landmark.observations) {
      if (!classes_->confusable(observation.class_id, landmark.state.class_id)) continue;
      (observation.truncated == 0 ? whole : cut).push_back(observation);
    }
    const auto wanted = static_cast<std::size_t>(options_.fit_views_max);
    std::vector<BoxView> views = to_views(spread(whole, wanted));
    if (views.size() < wanted) {
      const std::vector<BoxView> more = to_views(spread(cut, wanted - views.size()));
      views.insert(views.end(), more.begin(), more.end());
    }
    return views;
  }

  std::vector<BoxView> to_views(const std::vector<Observation>& observations) const {
    std::vector<BoxView> views;
    views.reserve(observations.size());
    for (const Observation& observation : observations) {
      views.push_back({T_map_keyframe_.at(observation.keyframe_id) * observation.T_keyframe_camera, observation.box,
                       observation.truncated});
    }
    return views;
  }

  void fit_due_landmarks() {
    int refits = 0;
    for (auto& [id, landmark] : landmarks_) {
      if (landmark.state.observations >= landmark.next_fit_at && changed_.count(id) != 0) {
        fit(&landmark);
      } else if (landmark.fit_due && refits < kRefitsPerFrame) {
        fit(&landmark);
        ++refits;
      }
    }
  }

  void fit(MappedLandmark* landmark) {
    const int n = landmark->state.observations;
    landmark->next_fit_at = n + std::max(5, static_cast<int>(options_.refit_growth * n));
    landmark->fit_due = false;
    const std::vector<BoxView> views = fit_views(*landmark);
    if (static_cast<int>(views.size()) < options_.min_views) return;
    const bool first = landmark->state.mean_iou == 0.0;
    const std::optional<Ellipsoid> initial =
        first || !landmark->state.ellipsoid ? initialise_sphere(camera_, views) : landmark->state.ellipsoid;
    if (!initial || (first && parallax_deg(views, initial->center()) < options_.min_baseline_deg)) return;
    const std::optional<QuadricFit> fit = refine_quadric(camera_, views, *initial);
    if (!fit || !is_sane(*fit)) return;
    Landmark& state = landmark->state;
    state.ellipsoid = fit->ellipsoid;
    state.center_covariance = fit->center_covariance;
    state.mean_iou = fit->mean_iou;
    state.baseline_deg = parallax_deg(views, fit->ellipsoid.center());
    state.anchor_keyframe_id = landmark->observations[landmark->observations.size() / 2].keyframe_id;
    changed_.insert(state.id);
  }

  bool is_sane(const QuadricFit& fit) const {
    return fit.median_depth_m > 0.2 && fit.median_depth_m < options_.max_depth_m &&
           fit.ellipsoid.semi_axes.maxCoeff() < options_.max_semi_axis_m && fit.mean_iou > options_.min_fit_iou;
  }

  void update_state(MappedLandmark* landmark) const {
    Landmark& state = landmark->state;
    state.quality = landmark_quality(state);
    const double seen_share = static_cast<double>(state.observations) / std::max(1, landmark->expected_frames);
    if (landmark->expected_frames > options_.retire_expected_frames && seen_share < options_.retire_seen_share) {
      state.state = LandmarkState::kRetired;
      return;
    }
    const bool confirmed = state.ellipsoid && state.observations >= options_.confirm_views &&
                           state.baseline_deg >= options_.confirm_baseline_deg &&
                           state.mean_iou >= options_.confirm_mean_iou && seen_share >= options_.confirm_seen_share;
    state.state = confirmed ? LandmarkState::kConfirmed : LandmarkState::kCandidate;
  }

  void maintain(std::int64_t stamp_ns, MapUpdate* update) {
    merge_duplicates(update);
    forget_stale_candidates(stamp_ns, update);
  }

  void forget_stale_candidates(std::int64_t stamp_ns, MapUpdate* update) {
    for (auto it = landmarks_.begin(); it != landmarks_.end();) {
      const double unseen_s = 1e-9 * static_cast<double>(stamp_ns - it->second.last_stamp_ns);
      if (unseen_s > options_.forget_candidate_s && it->second.state.observations < options_.forget_candidate_views) {
        update->removed.push_back(it->first);
        it = landmarks_.erase(it);
      } else {
        ++it;
      }
    }
  }

  /// Landmarks with an ellipsoid, most observed first.
  std::vector<std::int64_t> by_observations() const {
    std::vector<std::int64_t> ids;
    for (const auto& [id, landmark] : landmarks_) {
      if (landmark.state.mean_iou > 0.0) ids.push_back(id);
    }
    std::stable_sort(ids.begin(), ids.end(), [this](std::int64_t a, std::int64_t b) {
      return landmarks_.at(a).state.observations > landmarks_.at(b).state.observations;
    });
    return ids;
  }

  void merge_duplicates(MapUpdate* update) {
    const std::vector<std::int64_t> ids = by_observations();
    for (std::size_t i = 0; i < ids.size(); ++i) {
      if (landmarks_.count(ids[i]) == 0) continue;
      for (std::size_t j = i + 1; j < ids.size(); ++j) {
        if (landmarks_.count(ids[j]) == 0) continue;
        if (is_duplicate(landmarks_.at(ids[i]), landmarks_.at(ids[j]))) merge(ids[i], ids[j], update);
      }
    }
  }

  struct Overlap {
    double iou = 0.0;     ///< of b's boxes with a's projection, median
    double inside = 0.0;  ///< share of b's boxes inside a's projection, median
  };

  Overlap overlap(const MappedLandmark& a, const MappedLandmark& b) const {
    std::vector<Observation> full;
    for (const Observation& observation : b.observations) {
      if (observation.truncated == 0) full.push_back(observation);
    }
    const Mat3 shape = a.state.ellipsoid->shape();
    std::vector<double> ious, insides;
    for (const BoxView& view : to_views(spread(full, kMergeViews))) {
      const std::optional<Box> projected =
          project_box(a.state.ellipsoid->center(), shape, projection_matrix(camera_, view.T_world_camera));
      const Box seen = clip(view.box, camera_.width, camera_.height);
      const Box box = projected ? clip(*projected, camera_.width, camera_.height) : Box{};
      ious.push_back(iou(box, seen));
      insides.push_back(seen.area() > 0.0 ? intersection_area(box, seen) / seen.area() : 0.0);
    }
    return {median(ious), median(insides)};
  }

  /// True if b, the less observed one, is the same object as a (design: class group, mutual overlap, veto).
  bool is_duplicate(const MappedLandmark& a, const MappedLandmark& b) const {
    const bool same = a.state.class_id == b.state.class_id;
    if (!same && !classes_->confusable(a.state.class_id, b.state.class_id)) return false;
    const Vec3& axes_a = a.state.ellipsoid->semi_axes;
    const Vec3& axes_b = b.state.ellipsoid->semi_axes;
    const double distance = (a.state.ellipsoid->center() - b.state.ellipsoid->center()).norm();
    if (distance > std::max(0.25, axes_a.maxCoeff() + axes_b.maxCoeff())) return false;
    const auto beside = a.seen_beside.find(b.state.id);
    const int common = beside == a.seen_beside.end() ? 0 : beside->second;
    const bool vetoed = common >= options_.merge_veto_share * b.state.observations;
    const Overlap o = overlap(a, b);
    if (!same) return o.iou > options_.merge_iou_confusable;
    return !vetoed && (o.iou > options_.merge_iou || distance < 0.5 * std::min(axes_a.mean(), axes_b.mean()));
  }

  void merge(std::int64_t survivor_id, std::int64_t merged_id, MapUpdate* update) {
    MappedLandmark& survivor = landmarks_.at(survivor_id);
    MappedLandmark merged = std::move(landmarks_.at(merged_id));
    landmarks_.erase(merged_id);
    redirects_[merged_id] = survivor_id;
    update->merged.push_back({merged_id, survivor_id});
    std::vector<Observation> all;
    all.reserve(survivor.observations.size() + merged.observations.size());
    std::merge(survivor.observations.begin(), survivor.observations.end(), merged.observations.begin(),
               merged.observations.end(), std::back_inserter(all),
               [](const Observation& a, const Observation& b) { return a.frame_id < b.frame_id; });
    survivor.observations = std::move(all);
    while (survivor.observations.size() > kObservationsMax) thin(&survivor.observations);
    survivor.state.observations += merged.state.observations;
    survivor.expected_frames = std::max(survivor.expected_frames, merged.expected_frames);
    survivor.last_stamp_ns = std::max(survivor.last_stamp_ns, merged.last_stamp_ns);
    for (const auto& [id, count] : merged.seen_beside) survivor.seen_beside[id] += count;
    changed_.insert(survivor_id);
    fit(&survivor);
  }

  /// Rigidly with the anchor keyframe; the fit from all corrected views follows in the next frames.
  void move(const std::map<std::int64_t, SE3>& before, MappedLandmark* landmark) {
    if (!landmark->state.ellipsoid) return;
    const auto old_pose = before.find(landmark->state.anchor_keyframe_id);
    if (old_pose == before.end()) return;
    const SE3 T_new_old = T_map_keyframe_.at(landmark->state.anchor_keyframe_id) * old_pose->second.inverse();
    landmark->state.ellipsoid->T_world_quadric = T_new_old * landmark->state.ellipsoid->T_world_quadric;
    landmark->fit_due = landmark->state.mean_iou > 0.0;
    changed_.insert(landmark->state.id);
  }

  /// At the end of a stream: every landmark fitted on all its views, duplicates and parts gone.
  void finish(MapUpdate* update) {
    for (auto& [id, landmark] : landmarks_) fit(&landmark);
    constexpr int kRounds = 3;  // a merge moves the survivor, which may uncover another duplicate
    for (int round = 0; round < kRounds; ++round) merge_duplicates(update);
    remove_parts(update);
  }

  /// A little-seen landmark inside a much-seen one of its class group is a part of it that the detector boxed alone.
  void remove_parts(MapUpdate* update) {
    constexpr double kPartInside = 0.7, kPartViews = 0.3;
    const std::vector<std::int64_t> ids = by_observations();
    for (std::size_t i = 0; i < ids.size(); ++i) {
      for (std::size_t j = i + 1; j < ids.size(); ++j) {
        if (landmarks_.count(ids[i]) == 0 || landmarks_.count(ids[j]) == 0) continue;
        const MappedLandmark& a = landmarks_.at(ids[i]);
        const MappedLandmark& b = landmarks_.at(ids[j]);
        if (!classes_->confusable(a.state.class_id, b.state.class_id)) continue;
        if (b.state.observations >= kPartViews * a.state.observations) continue;
        if ((a.state.ellipsoid->center() - b.state.ellipsoid->center()).norm() >
            a.state.ellipsoid->semi_axes.maxCoeff() + b.state.ellipsoid->semi_axes.maxCoeff()) {
          continue;
        }
        if (overlap(a, b).inside <= kPartInside) continue;
        landmarks_.erase(ids[j]);
        update->removed.push_back(ids[j]);
      }
    }
  }

  QuadricMapperOptions options_;
  std::shared_ptr<const ClassTable> classes_;
  Camera camera_;
  SE3 T_map_odom_;
  std::map<std::int64_t, SE3> T_map_keyframe_, T_odom_keyframe_;
  Landmarks landmarks_;
  std::map<std::int64_t, std::int64_t> redirects_;  ///< merged id -> survivor
  std::uint64_t map_version_ = 0;
  bool finishing_ = false;          ///< the end frame has been seen
  std::set<std::int64_t> changed_;  ///< by the update being made
};

QuadricMapper::QuadricMapper(const QuadricMapperOptions& options, std::shared_ptr<const ClassTable> classes)
    : impl_(std::make_unique<Impl>(options, std::move(classes))) {}
QuadricMapper::~QuadricMapper() = default;
QuadricMapper::QuadricMapper(QuadricMapper&&) noexcept = default;
QuadricMapper& QuadricMapper::operator=(QuadricMapper&&) noexcept = default;

MapUpdate QuadricMapper::integrate(const Frame& frame, const AssociationFrame& associations) {
  return impl_->integrate(frame, associations);
}
MapUpdate QuadricMapper::apply(const MapCorrection& correction) { return impl_->apply(correction); }
std::vector<Landmark> QuadricMapper::landmarks() const { return impl_->landmarks(); }
std::uint64_t QuadricMapper::map_version() const { return impl_->map_version(); }
const SE3& QuadricMapper::T_map_odom() const { return impl_->T_map_odom(); }

}  // namespace semantic_topo_loop::core
