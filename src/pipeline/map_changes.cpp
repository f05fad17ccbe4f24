#include "pipeline/map_changes.h"

#include <algorithm>
#include <map>
#include <tuple>

#include "geometry/statistics.h"
#include "semantic_topo_loop/geometry/quadric.h"

namespace semantic_topo_loop::core {
namespace {

/// For which the last session should have boxes of what is gone, and the ones before must have had; what is new must
/// have them, and by which another one holds a place.
constexpr double kMinSeen_s = 2.0;
/// Keyframes that must have had a place in view, since detectors miss an object for seconds on end; where there are
/// boxes of both times to compare; of one that moved there, since it is gone elsewhere; and where many objects are
/// asked about at once.
constexpr int kMinLooks = 15, kMinLooksOfGone = 5, kMinLooksOfMoved = 2, kMinLooksOfMany = 2;
/// For which depth must have shown what lies behind an object that is gone, wherever from.
constexpr double kMinSeenThrough_s = 1.0;
/// Of the boxes of an object that is gone, what the last session may have by mistake: a share of those that it should
/// have, or two, or those of so short a time.
constexpr double kMistakenShare = 0.05, kMistakenBoxes = 2.0, kMistaken_s = 0.2;
/// An object that is boxed for longer than it is in view, by this factor, is not where the map has it.
constexpr double kMaxSeenShare = 1.25;
/// Of a projection that must be in view to be asked about, however little of it was seen before.
constexpr double kLeastShare = 0.1;
/// Of the boxes of an object: as little of it as the fewest of them show is no view that one asks about.
constexpr double kRareShare = 0.25;
/// Of the radii of one object, as two sessions have them.
constexpr double kMaxRatio = 1.6;

/// Boxes of a landmark, and the time that one stands for.
struct Boxes {
  int before = 0, after = 0;
  double one_s = 0.0;

  double before_s() const { return one_s * before; }
  double after_s() const { return one_s * after; }
};

bool is_as_large(const Ellipsoid& a, const Ellipsoid& b) {
  const double ratio = a.radius() / b.radius();
  return ratio < kMaxRatio && ratio > 1.0 / kMaxRatio;
}

Boxes count_boxes(const MappedLandmark& landmark, std::int64_t first_keyframe_id) {
  Boxes boxes;
  for (const Observation& observation : landmark.observations) {
    ++(observation.keyframe_id < first_keyframe_id ? boxes.before : boxes.after);
  }
  const double seen_s = landmark.sightings.seen_s;
  boxes.one_s = std::min(kStepMax_s, seen_s / std::max(1.0, static_cast<double>(landmark.observations.size())));
  return boxes;
}

/// How a landmark's boxes showed it: from where, how large, and how much of it.
struct SeenAs {
  SeenFrom from;
  double least_share = kFullyVisibleShare;  ///< of it in view, in most of its boxes
};

SeenAs seen_as(const MappedLandmark& landmark, const Camera& camera, const KeyframePlaces& S_map_keyframe) {
  SeenAs seen{landmark.seen_from};
  std::vector<double> shares;
  const Box image = camera.image();
  for (const Observation& observation : landmark.observations) {
    const auto keyframe = S_map_keyframe.find(observation.keyframe_id);
    if (keyframe == S_map_keyframe.end()) continue;
    const SE3 T_map_camera = keyframe->second.pose(observation.view.T_world_camera);
    const Ellipsoid& ellipsoid = *landmark.state.ellipsoid;
    const std::optional<Box> whole =
        project_box(ellipsoid.center(), ellipsoid.shape(), projection_matrix(camera, T_map_camera));
    if (!whole) continue;
    const Box visible = clip(*whole, image);
    if (!visible.is_valid()) continue;
    shares.push_back(visible.area() / whole->area());
    if (shares.back() <= kFullyVisibleShare) seen.from.add(ellipsoid.center() - T_map_camera.t, visible.size());
  }
  if (!shares.empty()) seen.least_share = std::min(seen.least_share, quantile(shares, kRareShare));
  return seen;
}

/// Of the objects of a map, which keyframes should have boxed them, since a detector did from there at some time.
class Looks {
 public:
  /// @param with_former those, too, that only were objects when the session before ended
  explicit Looks(const MapState& map, bool with_former = false) : map_(map) {
    KeyframePlaces S_map_keyframe;
    for (const KeyframePose& pose : map.keyframe_poses()) {
      S_map_keyframe[pose.keyframe_id] = Sim3(pose.T_map_camera, pose.scale);
    }
    for (const MappedLandmark& landmark : map.objects.landmarks) {
      const bool is_object =
          landmark.state.state == LandmarkState::kConfirmed || (with_former && landmark.was_confirmed);
      if (!is_object || !landmark.state.ellipsoid) continue;
      MappedLandmark& known = landmarks_[landmark.state.id];
      known.state = landmark.state;
      known.state.state = LandmarkState::kConfirmed;
      seen_as_[landmark.state.id] = seen_as(landmark, map.objects.camera, S_map_keyframe);
    }
  }

  /// From the first to the last keyframe with boxes: a map that is fixed takes none, and misses nothing.
  /// @return how many keyframes from `begin` to before `end`, by the landmark's id
  std::map<std::int64_t, int> count(std::int64_t begin, std::int64_t end) const {
    std::int64_t first = end, last = begin - 1;
    for (const MappedLandmark& landmark : map_.objects.landmarks) {
      for (const Observation& observation : landmark.observations) {
        if (observation.keyframe_id < begin || observation.keyframe_id >= end) continue;
        first = std::min(first, observation.keyframe_id);
        last = std::max(last, observation.keyframe_id);
      }
    }
    std::map<std::int64_t, int> looks;
    Frame frame;
    frame.camera = map_.objects.camera;
    for (const GraphKeyframe& keyframe : map_.graph.keyframes) {
      const KeyframePose& pose = keyframe.pose;
      if (pose.keyframe_id < first) continue;
      if (pose.keyframe_id > last) break;
      for (const ExpectedLandmark& expected :
           expected_landmarks(landmarks_, frame, nullptr, pose.T_map_camera, {}, kLeastShare)) {
        const SeenAs& as = seen_as_.at(expected.id);
        const Vec3 direction = landmarks_.at(expected.id).state.ellipsoid->center() - pose.T_map_camera.t;
        if (expected.share > as.least_share && as.from.covers(direction, expected.size_px)) ++looks[expected.id];
      }
    }
    return looks;
  }

 private:
  const MapState& map_;
  std::map<std::int64_t, MappedLandmark> landmarks_;
  std::map<std::int64_t, SeenAs> seen_as_;
};

/// For how long depth has shown what lies behind an object since its last box, less what its holes may show.
double seen_through_s(const MappedLandmark& landmark) {
  const Sightings& sightings = landmark.sightings;
  return sightings.seen_through_since_s * (1.0 - sightings.hole_share());
}

/// Whether another stands, or stood, in the place of a landmark. @param is_there whether one counts
template <class IsThere>
bool is_taken(const MapState& map, const Landmark& landmark, const IsThere& is_there) {
  const Ellipsoid& place = *landmark.ellipsoid;
  return std::any_of(map.objects.landmarks.begin(), map.objects.landmarks.end(), [&](const MappedLandmark& other) {
    if (!other.state.ellipsoid || other.state.id == landmark.id) return false;
    const double apart_m = (other.state.ellipsoid->center() - place.center()).norm();
    return apart_m < std::max(place.radius(), other.state.ellipsoid->radius()) && is_there(other);
  });
}

/// Joins what is gone with what is new of its class, and drops what is hardly new.
void find_moves(const MapState& map, std::vector<MapChange>* gone, std::vector<MapChange>* added) {
  const auto landmark = [&map](std::int64_t id) -> const Landmark& {
    return std::lower_bound(map.objects.landmarks.begin(), map.objects.landmarks.end(), id,
                            [](const MappedLandmark& p, std::int64_t other) { return p.state.id < other; })
        ->state;
  };
  std::vector<std::tuple<double, std::size_t, std::size_t>> pairs;  // distance, gone, new
  for (std::size_t i = 0; i < gone->size(); ++i) {
    const Landmark& before = landmark(*(*gone)[i].before_id);
    for (std::size_t j = 0; j < added->size(); ++j) {
      const Landmark& after = landmark(*(*added)[j].after_id);
      if (after.class_id != before.class_id || !is_as_large(*after.ellipsoid, *before.ellipsoid)) continue;
      pairs.emplace_back((after.ellipsoid->center() - before.ellipsoid->center()).norm(), i, j);
    }
  }
  std::sort(pairs.begin(), pairs.end());
  for (const auto& [distance, i, j] : pairs) {
    MapChange &from = (*gone)[i], &to = (*added)[j];
    if (from.kind == MapChange::Kind::kMoved || !to.after_id) continue;
    from.kind = MapChange::Kind::kMoved;
    from.after_id = to.after_id;
    from.boxes_after = to.boxes_after;
    from.looked_at_before = to.looked_at_before;
    to.after_id.reset();
  }
  const auto is_no_more = [](const MapChange& change) {
    return !change.after_id || change.looked_at_before < kMinLooks;
  };
  added->erase(std::remove_if(added->begin(), added->end(), is_no_more), added->end());
}

}  // namespace

const char* to_string(MapChange::Kind kind) {
  switch (kind) {
    case MapChange::Kind::kGone:
      return "gone";
    case MapChange::Kind::kMoved:
      return "moved";
    case MapChange::Kind::kNew:
      break;
  }
  return "new";
}

std::vector<MapChange> map_changes(const MapState& map) {
  if (map.graph.sessions.size() < 2) return {};
  const std::int64_t first = map.graph.sessions.back().first_keyframe_id;
  const Looks looks(map, true);
  std::map<std::int64_t, int> looks_before = looks.count(0, first);
  std::map<std::int64_t, int> looks_after = looks.count(first, map.graph.next_keyframe_id());
  std::vector<MapChange> gone, added;
  for (const MappedLandmark& landmark : map.objects.landmarks) {
    const Landmark& state = landmark.state;
    const bool is_confirmed = state.state == LandmarkState::kConfirmed;
    if (!state.ellipsoid || (!is_confirmed && !landmark.was_confirmed)) continue;
    const Boxes boxes = count_boxes(landmark, first);
    const int looked_before = looks_before[state.id], looked_after = looks_after[state.id];
    MapChange change;
    change.boxes_before = boxes.before;
    if (boxes.before > 0) {
      if (boxes.before_s() < kMinSeen_s) continue;
      const double expected = static_cast<double>(boxes.before) * looked_after / std::max(looked_before, 1);
      const bool is_missed = looked_after >= kMinLooksOfGone && boxes.one_s * expected >= kMinSeen_s;
      change.seen_through_s = seen_through_s(landmark);
      if (!is_missed && change.seen_through_s < kMinSeenThrough_s) continue;
      const double should_have = is_missed ? std::min<double>(boxes.before, expected) : boxes.before;
      const bool is_mistake =
          boxes.after <= std::max(kMistakenShare * should_have, kMistakenBoxes) || boxes.after_s() <= kMistaken_s;
      if (!is_mistake) continue;
      // By one of its size, it is that one, by another id.
      const auto is_there_now = [&](const MappedLandmark& other) {
        return count_boxes(other, first).after_s() >= kMinSeen_s &&
               is_as_large(*other.state.ellipsoid, *state.ellipsoid);
      };
      if (is_taken(map, state, is_there_now)) continue;
      change.before_id = state.id;
      change.looked_at_after = looked_after;
      gone.push_back(change);
    } else if (is_confirmed && boxes.after_s() >= kMinSeen_s &&
               (landmark.sightings.is_placed() || landmark.sightings.seen_share() <= kMaxSeenShare)) {
      change.kind = MapChange::Kind::kNew;
      change.after_id = state.id;
      change.boxes_after = boxes.after;
      change.looked_at_before = looked_before;
      // What had left before the session is there no more.
      const auto was_there = [first](const MappedLandmark& other) {
        return (other.state.state != LandmarkState::kRetired || other.was_confirmed) &&
               count_boxes(other, first).before_s() >= kMinSeen_s;
      };
      if (looked_before >= kMinLooksOfMoved && !is_taken(map, state, was_there)) added.push_back(change);
    }
  }
  find_moves(map, &gone, &added);
  gone.insert(gone.end(), added.begin(), added.end());
  return gone;
}

MapAgreement map_agreement(const MapState& map, std::int64_t first_keyframe_id) {
  const Looks looks(map);
  std::map<std::int64_t, int> looks_before = looks.count(0, first_keyframe_id);
  std::map<std::int64_t, int> looks_after = looks.count(first_keyframe_id, map.graph.next_keyframe_id());
  MapAgreement agreement;
  for (const MappedLandmark& landmark : map.objects.landmarks) {
    if (landmark.state.state != LandmarkState::kConfirmed) continue;
    const Boxes boxes = count_boxes(landmark, first_keyframe_id);
    if (boxes.before > 0 && boxes.after > 0) {
      ++agreement.common;
    } else if (boxes.before > 0 && looks_after[landmark.state.id] >= kMinLooksOfMany) {
      ++agreement.only_first;
    } else if (boxes.after > 0 && looks_before[landmark.state.id] >= kMinLooksOfMany) {
      ++agreement.only_second;
    }
  }
  return agreement;
}

}  // namespace semantic_topo_loop::core
