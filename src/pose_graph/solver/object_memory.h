#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include "pose_graph/solver/graph_object.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/landmark.h"

namespace semantic_topo_loop::core {

/// What the pose graph remembers of the objects: the boxes in its keyframes, and the map's landmarks with their merges.
class ObjectMemory {
 public:
  /// The boxes of a keyframe.
  void add(int vertex, const Frame& frame, const AssociationFrame& associations);
  /// @param vertex_of by keyframe_id   @param T_map_vertex as they were when the update was made
  void apply(const MapUpdate& update, const std::map<std::int64_t, int>& vertex_of,
             const std::vector<SE3>& T_map_vertex);

  /// The landmarks that are confirmed, in order of id, with all their views: those that merged link all passes that
  /// saw them.
  std::vector<GraphObject> objects() const;
  bool empty() const { return landmarks_.empty(); }

 private:
  struct Sighting {
    std::int64_t landmark_id = -1;  ///< as associated
    GraphObjectView view;
  };

  std::int64_t resolve(std::int64_t id) const;

  std::vector<Sighting> sightings_;                ///< in order of the keyframes
  std::map<std::int64_t, GraphObject> landmarks_;  ///< confirmed, without views
  std::map<std::int64_t, std::int64_t> survivor_of_;
};

}  // namespace semantic_topo_loop::core
