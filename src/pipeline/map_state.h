#pragma once

#include <cstdint>
#include <vector>

#include "map/mapper_state.h"
#include "pose_graph/graph_state.h"
#include "semantic_topo_loop/types/local_map.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// One run of a robot. Ids go on from one session to the next.
struct Session {
  std::int64_t first_keyframe_id = 0;
  std::int64_t begin_ns = 0, end_ns = 0;  ///< stamps of its first and last keyframe
};

/// A map of one or more sessions: what a later one goes on with.
struct MapState {
  std::vector<Session> sessions;  ///< in order of their keyframes
  std::int64_t next_frame_id = 0;
  GraphState graph;
  MapperState objects;
  std::vector<LocalMap> submaps;  ///< in the odometry's unit of length; T_odom_anchor leads to the map

  std::int64_t next_keyframe_id() const {
    return graph.keyframes.empty() ? 0 : graph.keyframes.back().pose.keyframe_id + 1;
  }
  std::vector<KeyframePose> keyframe_poses() const;
  /// The submaps in the map's unit of length.
  std::vector<LocalMap> submaps_in_unit() const;
  /// Adds a map of which it is not known where it is: it comes to stand beside this one, with ids that follow.
  void append(MapState other);
};

/// Where something unplaced stands, so that nothing of the map is taken for what it shows: some way beside it, along x.
SE3 place_beside(const MapState& map);

/// @return an error that names what does not fit together
Status check(const MapState& map);

}  // namespace semantic_topo_loop::core
