#include "pipeline/map_state.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>
#include <set>
#include <utility>

#include "semantic_topo_loop/pipeline/object_slam.h"
#include "semantic_topo_loop/pose_graph/pose_graph_options.h"

namespace semantic_topo_loop::core {
namespace {

/// Beyond what a camera sees of the objects of a map, and within what a break leaves open.
constexpr double kBeside_m = 20.0;

std::int64_t next_landmark_id(const MapState& map) {
  return map.objects.landmarks.empty() ? 0 : map.objects.landmarks.back().state.id + 1;
}

void raise(std::int64_t by, std::int64_t* id) {
  if (*id >= 0) *id += by;
}

void raise_ids(std::int64_t frames, std::int64_t keyframes, LoopFigures* loop) {
  for (std::int64_t* id : {&loop->query_keyframe_id, &loop->match_keyframe_id}) raise(keyframes, id);
  for (std::int64_t* id : {&loop->query_frame, &loop->match_frame, &loop->query_begin, &loop->query_end,
                           &loop->match_begin, &loop->match_end}) {
    raise(frames, id);
  }
}

void raise_ids(std::int64_t frames, std::int64_t keyframes, RememberedLoop* loop) {
  raise(keyframes, &loop->told.query_keyframe_id);
  raise(keyframes, &loop->told.match_keyframe_id);
  if (!loop->loop) return;
  for (std::int64_t* id : {&loop->loop->query_keyframe_id, &loop->loop->match_keyframe_id}) raise(keyframes, id);
  for (std::int64_t* id :
       {&loop->loop->query_begin, &loop->loop->query_end, &loop->loop->match_begin, &loop->loop->match_end}) {
    raise(frames, id);
  }
}

void raise_ids(std::int64_t frames, std::int64_t keyframes, std::int64_t landmarks, MappedLandmark* landmark) {
  raise(landmarks, &landmark->state.id);
  raise(keyframes, &landmark->state.anchor_keyframe_id);
  for (Observation& observation : landmark->observations) {
    raise(frames, &observation.frame_id);
    raise(keyframes, &observation.keyframe_id);
    raise(landmarks, &observation.source_id);
  }
  std::map<std::int64_t, int> seen_beside;
  for (const auto& [id, count] : landmark->seen_beside) seen_beside[id + landmarks] = count;
  landmark->seen_beside = std::move(seen_beside);
}

void raise_ids(std::int64_t frames, std::int64_t keyframes, std::int64_t landmarks, LocalMap* submap) {
  raise(keyframes, &submap->keyframe_id);
  for (std::int64_t* id : {&submap->frame_id, &submap->begin_frame, &submap->end_frame}) raise(frames, id);
  for (LocalFrame& frame : submap->frames) {
    raise(frames, &frame.frame_id);
    for (ObservedBox& box : frame.boxes) raise(landmarks, &box.landmark_id);
  }
  for (LocalObject& object : submap->objects) raise(landmarks, &object.landmark_id);
}

void move(const SE3& T_new_old, MapState* map) {
  for (GraphKeyframe& keyframe : map->graph.keyframes) {
    keyframe.pose.T_map_camera = T_new_old * keyframe.pose.T_map_camera;
    if (keyframe.T_map_live) keyframe.T_map_live = T_new_old * *keyframe.T_map_live;
  }
  for (MappedLandmark& landmark : map->objects.landmarks) {
    std::optional<Ellipsoid>& ellipsoid = landmark.state.ellipsoid;
    if (ellipsoid) ellipsoid->T_world_quadric = T_new_old * ellipsoid->T_world_quadric;
  }
  for (LocalMap& submap : map->submaps) submap.T_odom_anchor = T_new_old * submap.T_odom_anchor;
}

}  // namespace

std::vector<KeyframePose> MapState::keyframe_poses() const {
  std::vector<KeyframePose> poses;
  poses.reserve(graph.keyframes.size());
  for (const GraphKeyframe& keyframe : graph.keyframes) poses.push_back(keyframe.pose);
  return poses;
}

std::vector<LocalMap> MapState::submaps_in_parts() const {
  const std::vector<int> parts = parts_of(graph);
  std::map<std::int64_t, int> part_of;
  for (std::size_t i = 0; i < parts.size(); ++i) part_of[graph.keyframes[i].pose.keyframe_id] = parts[i];
  std::vector<LocalMap> result = submaps;
  for (LocalMap& submap : result) submap.segment = LocalMap::kOtherSession - part_of[submap.keyframe_id];
  return result;
}

Status MapState::check_scale(const PoseGraphOptions& options) const {
  const bool has_scales = std::any_of(graph.keyframes.begin(), graph.keyframes.end(),
                                      [](const GraphKeyframe& keyframe) { return keyframe.pose.scale != 1.0; });
  if (!has_scales || options.scale == "free") return {};
  return Error{"its unit of length drifts, which needs pose_graph.scale = free"};
}

std::vector<LocalMap> MapState::submaps_in_unit() const {
  std::vector<LocalMap> result = submaps_in_parts();
  rescale(keyframe_poses(), &result);
  return result;
}

void MapState::append(MapState other) {
  move(SE3(Quaternion::Identity(), place_beside(*this) + place_beside(other)), &other);
  const std::int64_t frames = graph.next_frame_id, keyframes = graph.next_keyframe_id();
  const std::int64_t landmarks = next_landmark_id(*this);
  for (Session& session : other.graph.sessions) session.first_keyframe_id += keyframes;
  other.graph.next_frame_id += frames;
  for (GraphKeyframe& keyframe : other.graph.keyframes) {
    raise(keyframes, &keyframe.pose.keyframe_id);
    raise(frames, &keyframe.pose.frame_id);
  }
  for (RememberedLoop& loop : other.graph.loops) raise_ids(frames, keyframes, &loop);
  graph.append(std::move(other.graph));
  if (objects.landmarks.empty()) objects.camera = other.objects.camera;
  forget_gone_neighbours(&objects.landmarks);
  forget_gone_neighbours(&other.objects.landmarks);
  for (MappedLandmark& landmark : other.objects.landmarks) {
    move_boxes(other.objects.camera, objects.camera, &landmark);
    raise_ids(frames, keyframes, landmarks, &landmark);
    objects.landmarks.push_back(std::move(landmark));
  }
  const std::int64_t merges = objects.merges.empty() ? 0 : objects.merges.back().number + 1;
  for (LoggedMerge& merge : other.objects.merges) {
    merge.number += merges;
    for (std::int64_t* id : {&merge.merge.merged_id, &merge.merge.survivor_id}) raise(landmarks, id);
    raise(frames, &merge.frame_id);
    if (merge.undone_frame_id) raise(frames, &*merge.undone_frame_id);
    objects.merges.push_back(merge);
  }
  for (LocalMap& submap : other.submaps) {
    raise_ids(frames, keyframes, landmarks, &submap);
    submaps.push_back(std::move(submap));
  }
  for (const PointsOfKeyframe& of : other.points) points.push_back({of.keyframe_id + keyframes, of.points});
  for (LoopFigures& loop : other.refused) {
    raise_ids(frames, keyframes, &loop);
    refused.push_back(loop);
  }
}

Vec3 place_beside(const MapState& map) {
  double reach_m = 0.0;
  for (const GraphKeyframe& keyframe : map.graph.keyframes) {
    reach_m = std::max(reach_m, keyframe.pose.T_map_camera.t.norm());
  }
  return {reach_m + kBeside_m, 0.0, 0.0};
}

std::map<std::int64_t, AssociationFrame> boxes_in_keyframes(const MapState& map) {
  std::map<std::int64_t, AssociationFrame> result;
  std::map<std::int64_t, std::int64_t> keyframe_of_frame;
  for (const GraphKeyframe& keyframe : map.graph.keyframes) {
    keyframe_of_frame[keyframe.pose.frame_id] = keyframe.pose.keyframe_id;
  }
  for (const MappedLandmark& landmark : map.objects.landmarks) {
    for (const Observation& observation : landmark.observations) {
      const auto keyframe = keyframe_of_frame.find(observation.frame_id);
      if (keyframe == keyframe_of_frame.end()) continue;
      AssociationFrame& boxes = result[keyframe->second];
      boxes.frame_id = observation.frame_id;
      Association& box = boxes.associations.emplace_back();
      box.landmark_id = landmark.state.id;
      box.class_id = observation.class_id;
      box.box = observation.view.box;
      box.truncated = observation.view.truncated;
      box.near_m = observation.view.near_m;
    }
  }
  return result;
}

void restore_points(const MapState& map, PointMap* points) {
  auto session = map.graph.sessions.begin();
  auto keyframe = map.graph.keyframes.begin();
  for (const PointsOfKeyframe& of : map.points) {
    while (session != map.graph.sessions.end() && session->first_keyframe_id <= of.keyframe_id) {
      points->begin_session();
      ++session;
    }
    while (keyframe->pose.keyframe_id < of.keyframe_id) ++keyframe;  // each has one: see leave_out_unplaced
    points->restore(of, Sim3(keyframe->pose.T_map_camera, keyframe->pose.scale));
  }
  points->begin_session(place_beside(map));
}

std::vector<std::int64_t> objects_under(const MapPoints& points, const MapState& map) {
  constexpr double kMargin = 1.1;  // of the semi-axes: depth is off by centimetres, quadrics are rounder than things
  const auto object_under = [&map](const Eigen::Vector3f& point_map) {
    std::int64_t id = -1;
    double depth = kMargin;
    for (const MappedLandmark& landmark : map.objects.landmarks) {
      if (landmark.state.state != LandmarkState::kConfirmed) continue;
      const Ellipsoid& ellipsoid = *landmark.state.ellipsoid;
      const Vec3 offset = point_map.cast<double>() - ellipsoid.center();
      if (offset.squaredNorm() > std::pow(kMargin * ellipsoid.semi_axes.maxCoeff(), 2)) continue;
      const Vec3 inside = ellipsoid.T_world_quadric.q.conjugate() * offset;
      const double now = inside.cwiseQuotient(ellipsoid.semi_axes).norm();
      if (now >= depth) continue;
      depth = now;
      id = landmark.state.id;
    }
    return id;
  };
  std::vector<std::int64_t> objects;
  for (const auto* part : {&points.sparse, &points.semi_dense}) {
    std::transform(part->begin(), part->end(), std::back_inserter(objects), object_under);
  }
  return objects;
}

std::size_t leave_out_unplaced(MapState* map) {
  std::map<std::int64_t, const SE3*> places;
  for (const GraphKeyframe& keyframe : map->graph.keyframes) {
    places[keyframe.pose.keyframe_id] = &keyframe.pose.T_map_camera;
  }
  std::size_t left_out = 0;
  for (MappedLandmark& landmark : map->objects.landmarks) {
    std::vector<Observation>& all = landmark.observations;
    const auto end = std::remove_if(all.begin(), all.end(), [&](const Observation& observation) {
      return observation.frame_id >= map->graph.next_frame_id || places.count(observation.keyframe_id) == 0;
    });
    left_out += static_cast<std::size_t>(all.end() - end);
    all.erase(end, all.end());
    if (all.empty() || !landmark.state.ellipsoid || places.count(landmark.state.anchor_keyframe_id) > 0) continue;
    landmark.state.anchor_keyframe_id = all[all.size() / 2].keyframe_id;
  }
  std::vector<MappedLandmark>& landmarks = map->objects.landmarks;
  landmarks.erase(std::remove_if(landmarks.begin(), landmarks.end(),
                                 [](const MappedLandmark& landmark) { return landmark.observations.empty(); }),
                  landmarks.end());
  std::vector<LoggedMerge>& merges = map->objects.merges;
  const auto made = std::remove_if(merges.begin(), merges.end(), [map](const LoggedMerge& merge) {
    return merge.frame_id >= map->graph.next_frame_id;
  });
  left_out += static_cast<std::size_t>(merges.end() - made);
  merges.erase(made, merges.end());
  for (LoggedMerge& merge : merges) {
    if (merge.undone_frame_id && *merge.undone_frame_id >= map->graph.next_frame_id) merge.undone_frame_id.reset();
  }
  std::vector<LocalMap> placed;
  for (LocalMap& submap : map->submaps) {
    const auto place = places.find(submap.keyframe_id);
    if (place == places.end() || submap.frame_id >= map->graph.next_frame_id) {
      ++left_out;
      continue;
    }
    submap.T_odom_anchor = *place->second;
    placed.push_back(std::move(submap));
  }
  map->submaps = std::move(placed);
  const auto is_unplaced = [&](const PointsOfKeyframe& of) { return places.count(of.keyframe_id) == 0; };
  const auto end = std::remove_if(map->points.begin(), map->points.end(), is_unplaced);
  left_out += static_cast<std::size_t>(map->points.end() - end);
  map->points.erase(end, map->points.end());
  const auto refused_end = std::remove_if(map->refused.begin(), map->refused.end(), [&](const LoopFigures& loop) {
    return places.count(loop.query_keyframe_id) == 0 || places.count(loop.match_keyframe_id) == 0;
  });
  left_out += static_cast<std::size_t>(map->refused.end() - refused_end);
  map->refused.erase(refused_end, map->refused.end());
  return left_out;
}

Status check(const MapState& map) {
  if (const Status graph = check(map.graph); !graph) return graph;
  std::set<std::int64_t> keyframes;
  for (const GraphKeyframe& keyframe : map.graph.keyframes) {
    keyframes.insert(keyframe.pose.keyframe_id);
  }
  std::int64_t last = -1;
  for (const MappedLandmark& landmark : map.objects.landmarks) {
    const std::string name = "object " + std::to_string(landmark.state.id);
    if (landmark.state.id <= last) return Error{name + " does not follow " + std::to_string(last)};
    last = landmark.state.id;
    for (const Observation& observation : landmark.observations) {
      if (keyframes.count(observation.keyframe_id) == 0) {
        return Error{name + " was seen in keyframe " + std::to_string(observation.keyframe_id) + ", not there"};
      }
    }
    if (landmark.state.ellipsoid && keyframes.count(landmark.state.anchor_keyframe_id) == 0) {
      return Error{name + " hangs on keyframe " + std::to_string(landmark.state.anchor_keyframe_id) + ", not there"};
    }
  }
  return {};
}

}  // namespace semantic_topo_loop::core
