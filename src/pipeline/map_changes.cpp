#include "pipeline/map_changes.h"

#include <algorithm>
#include <map>
#include <tuple>

namespace semantic_topo_loop::core {
namespace {

/// Boxes that the last session should have of what is gone, that what is new must have, and by which another one holds
/// a place: a second or two.
constexpr int kMinBoxes = 30;
/// Boxes that the sessions before should have of what is gone: of chairs that went in rendered rooms there were 21 to
/// 79, of what never was 16 and 19.
constexpr int kMinBoxesBefore = 20;
/// Keyframes that must have had a place in view, since detectors miss an object for seconds on end; where there are
/// boxes of both times to compare; of one that moved there, since it is gone elsewhere; and where many objects are
/// asked about at once.
constexpr int kMinLooks = 15, kMinLooksOfGone = 5, kMinLooksOfMoved = 2, kMinLooksOfMany = 2;
/// For which depth must have shown what lies behind an object that is gone, wherever from.
constexpr double kMinSeenThrough_s = 1.0;
/// Of the boxes of an object that is gone, what the last session may have by mistake.
constexpr double kMistakenShare = 0.05;
/// An object that is boxed for longer than it is in view, by this factor, is not where the map has it.
constexpr double kMaxSeenShare = 1.25;
/// Of the radii of one object, as two sessions have them.
constexpr double kMaxRatio = 1.6;

struct Boxes {
  int before = 0, after = 0;
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
  return boxes;
}

/// Keyframes from `begin` to before `end` in which a detector should have boxed what the map has there, since it did
/// from there at some time; by the landmark's id. @param with_former those, too, that only were objects when the
/// session before ended
std::map<std::int64_t, int> count_looks(const MapState& map, std::int64_t begin, std::int64_t end,
                                        bool with_former = false) {
  std::map<std::int64_t, MappedLandmark> landmarks;
  for (const MappedLandmark& landmark : map.objects.landmarks) {
    if (landmark.state.state != LandmarkState::kConfirmed && !(with_former && landmark.was_confirmed)) continue;
    MappedLandmark& known = landmarks[landmark.state.id];
    known.state = landmark.state;
    known.state.state = LandmarkState::kConfirmed;
    known.seen_from = landmark.seen_from;
  }
  std::map<std::int64_t, int> looks;
  Frame frame;
  frame.camera = map.objects.camera;
  for (const auto& [pose, T_vertex_keyframe] : map.graph.keyframes) {
    if (pose.keyframe_id < begin) continue;
    if (pose.keyframe_id >= end) break;
    for (const ExpectedLandmark& expected : expected_landmarks(landmarks, frame, nullptr, pose.T_map_camera, {})) {
      const MappedLandmark& landmark = landmarks.at(expected.id);
      const Vec3 direction = landmark.state.ellipsoid->center() - pose.T_map_camera.t;
      if (landmark.seen_from.covers(direction, expected.size_px)) ++looks[expected.id];
    }
  }
  return looks;
}

/// For how long depth has shown what lies behind an object since its last box, less what its holes may show.
double seen_through_s(const MappedLandmark& landmark) {
  const Sightings& sightings = landmark.sightings;
  const double holes = sightings.transparent_s / std::max(sightings.seen_s, sightings.transparent_s + 1e-9);
  return sightings.seen_through_since_s * (1.0 - holes);
}

/// Whether another stands, or stood, in the place of a landmark. @param is_there whether one counts
template <class IsThere>
bool is_taken(const MapState& map, const Ellipsoid& place, const IsThere& is_there) {
  return std::any_of(map.objects.landmarks.begin(), map.objects.landmarks.end(), [&](const MappedLandmark& other) {
    if (!other.state.ellipsoid || !is_there(other)) return false;
    const double apart_m = (other.state.ellipsoid->center() - place.center()).norm();
    return apart_m < std::max(place.radius(), other.state.ellipsoid->radius());
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
  std::map<std::int64_t, int> looks_before = count_looks(map, 0, first, true);
  std::map<std::int64_t, int> looks_after = count_looks(map, first, map.graph.next_keyframe_id(), true);
  std::vector<MapChange> gone, added;
  for (const MappedLandmark& landmark : map.objects.landmarks) {
    const Landmark& state = landmark.state;
    const bool is_confirmed = state.state == LandmarkState::kConfirmed;
    if (!state.ellipsoid || (!is_confirmed && !landmark.was_confirmed)) continue;
    const auto [before, after] = count_boxes(landmark, first);
    const int looked_before = looks_before[state.id], looked_after = looks_after[state.id];
    MapChange change;
    change.boxes_before = before;
    if (before > 0) {
      if (before < kMinBoxesBefore) continue;
      const int expected = static_cast<int>(std::int64_t{before} * looked_after / std::max(looked_before, 1));
      const bool is_missed = looked_after >= kMinLooksOfGone && expected >= kMinBoxes;
      change.seen_through_s = seen_through_s(landmark);
      if (!is_missed && change.seen_through_s < kMinSeenThrough_s) continue;
      if (after > kMistakenShare * (is_missed ? std::min(before, expected) : before)) continue;
      // By one of its size, it is that one, by another id.
      const auto is_there_now = [&](const MappedLandmark& other) {
        return count_boxes(other, first).after >= kMinBoxes && is_as_large(*other.state.ellipsoid, *state.ellipsoid);
      };
      if (is_taken(map, *state.ellipsoid, is_there_now)) continue;
      change.before_id = state.id;
      change.looked_at_after = looked_after;
      gone.push_back(change);
    } else if (is_confirmed && after >= kMinBoxes &&
               (landmark.sightings.is_placed() || landmark.sightings.seen_share() <= kMaxSeenShare)) {
      change.kind = MapChange::Kind::kNew;
      change.after_id = state.id;
      change.boxes_after = after;
      change.looked_at_before = looked_before;
      const auto was_there = [first](const MappedLandmark& other) {
        return count_boxes(other, first).before >= kMinBoxes;
      };
      if (looked_before >= kMinLooksOfMoved && !is_taken(map, *state.ellipsoid, was_there)) added.push_back(change);
    }
  }
  find_moves(map, &gone, &added);
  gone.insert(gone.end(), added.begin(), added.end());
  return gone;
}

MapAgreement map_agreement(const MapState& map, std::int64_t first_keyframe_id) {
  std::map<std::int64_t, int> looks_before = count_looks(map, 0, first_keyframe_id);
  std::map<std::int64_t, int> looks_after = count_looks(map, first_keyframe_id, map.graph.next_keyframe_id());
  MapAgreement agreement;
  for (const MappedLandmark& landmark : map.objects.landmarks) {
    if (landmark.state.state != LandmarkState::kConfirmed) continue;
    const auto [before, after] = count_boxes(landmark, first_keyframe_id);
    if (before > 0 && after > 0) {
      ++agreement.common;
    } else if (before > 0 && looks_after[landmark.state.id] >= kMinLooksOfMany) {
      ++agreement.only_first;
    } else if (after > 0 && looks_before[landmark.state.id] >= kMinLooksOfMany) {
      ++agreement.only_second;
    }
  }
  return agreement;
}

}  // namespace semantic_topo_loop::core
