#include "pipeline/map_changes.h"

#include <algorithm>
#include <map>
#include <tuple>

namespace semantic_topo_loop::core {
namespace {

/// Boxes that must be kept of an object to be one, and time for which the last session must have missed what is gone: a
/// second or two of each.
constexpr int kMinBoxes = 30;
constexpr double kMinMissed_s = 2.0;
/// Keyframes that must have had a place in view, since detectors miss an object for seconds on end; and of one that
/// moved there, since it is gone elsewhere; and where many objects are asked about at once.
constexpr int kMinLooks = 10, kMinLooksOfMoved = 2, kMinLooksOfMany = 2;
/// Of the boxes of an object that is gone, what the last session may have by mistake.
constexpr double kMistakenShare = 0.05;
/// An object that is boxed for longer than it is in view, by this factor, is not where the map has it.
constexpr double kMaxSeenShare = 1.25;
/// Of the radii of one object, as two sessions have them.
constexpr double kMaxRatio = 1.6;

struct Boxes {
  int before = 0, after = 0;
};

Boxes count_boxes(const MappedLandmark& landmark, std::int64_t first_keyframe_id) {
  Boxes boxes;
  for (const Observation& observation : landmark.observations) {
    ++(observation.keyframe_id < first_keyframe_id ? boxes.before : boxes.after);
  }
  return boxes;
}

/// Keyframes from `begin` to before `end` in which a detector should have boxed what the map has there, since it did
/// from there at some time; by the landmark's id.
std::map<std::int64_t, int> count_looks(const MapState& map, std::int64_t begin, std::int64_t end) {
  std::map<std::int64_t, MappedLandmark> landmarks;
  for (const MappedLandmark& landmark : map.objects.landmarks) {
    if (landmark.state.state == LandmarkState::kCandidate) continue;
    MappedLandmark& known = landmarks[landmark.state.id];
    known.state = landmark.state;
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

/// Whether the place of a landmark was taken by one of about the same kind before: it is that one, by another id.
bool was_there(const MapState& map, const MappedLandmark& landmark, std::int64_t first_keyframe_id) {
  const Ellipsoid& ellipsoid = *landmark.state.ellipsoid;
  return std::any_of(map.objects.landmarks.begin(), map.objects.landmarks.end(), [&](const MappedLandmark& other) {
    if (!other.state.ellipsoid || count_boxes(other, first_keyframe_id).before < kMinBoxes) return false;
    const double apart_m = (other.state.ellipsoid->center() - ellipsoid.center()).norm();
    return apart_m < std::max(ellipsoid.radius(), other.state.ellipsoid->radius());
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
      const double ratio = after.ellipsoid->radius() / before.ellipsoid->radius();
      if (after.class_id != before.class_id || ratio > kMaxRatio || ratio < 1.0 / kMaxRatio) continue;
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
  std::map<std::int64_t, int> looks = count_looks(map, 0, first);
  std::vector<MapChange> gone, added;
  for (const MappedLandmark& landmark : map.objects.landmarks) {
    const Landmark& state = landmark.state;
    if (!state.ellipsoid) continue;
    const auto [before, after] = count_boxes(landmark, first);
    MapChange change;
    change.boxes_before = before;
    change.missed_s = landmark.sightings.missed_since_s + landmark.sightings.seen_through_since_s;
    if (state.state == LandmarkState::kRetired && before >= kMinBoxes && after <= kMistakenShare * before &&
        change.missed_s >= kMinMissed_s) {
      change.before_id = state.id;
      gone.push_back(change);
    } else if (state.state == LandmarkState::kConfirmed && before == 0 && after >= kMinBoxes &&
               landmark.sightings.seen_share() <= kMaxSeenShare) {
      change.kind = MapChange::Kind::kNew;
      change.missed_s = 0.0;
      change.after_id = state.id;
      change.boxes_after = after;
      change.looked_at_before = looks[state.id];
      if (change.looked_at_before >= kMinLooksOfMoved && !was_there(map, landmark, first)) added.push_back(change);
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
