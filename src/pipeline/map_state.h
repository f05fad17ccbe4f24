#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "map/mapper_state.h"
#include "pose_graph/graph_state.h"
#include "semantic_topo_loop/map/point_map.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/local_map.h"
#include "semantic_topo_loop/types/loop_closure.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

struct PoseGraphOptions;

/// A map of one or more sessions: what a later one goes on with.
struct MapState {
  std::string configuration;  ///< options of the last session (YAML), for who wonders how it came about
  GraphState graph;
  MapperState objects;
  std::size_t left_out = 0;              ///< see leave_out_unplaced
  std::vector<LocalMap> submaps;         ///< in the odometry's unit of length; T_odom_anchor leads to the map
  std::vector<PointsOfKeyframe> points;  ///< in order of keyframe_id
  std::vector<LoopFigures> refused;      ///< candidates that loop detection refused, see LoopDetector::refused

  std::vector<KeyframePose> keyframe_poses() const;
  /// @return an error if its odometry's unit of length drifts, so that only poses with a scale of their own hold it
  /// together, and these options give none
  Status check_scale(const PoseGraphOptions& options) const;
  /// The submaps with the part of the map that each is in, by `parts_of`, as their segment.
  std::vector<LocalMap> submaps_in_parts() const;
  /// The same in the map's unit of length.
  std::vector<LocalMap> submaps_in_unit() const;
  /// Adds a map of which it is not known where it is: it comes to stand beside this one, with ids that follow.
  void append(MapState other);
};

/// What is new in a map: of those stages that tell.
struct MapDelta {
  std::optional<GraphDelta> graph;
  std::optional<MapperDelta> objects;
  std::optional<SubmapDelta> submaps;
  std::vector<PointsOfKeyframe> points;  ///< of new keyframes
};

/// Twice a second, by the stamps of the data, a map is saved.
class SavePoints {
 public:
  bool is_due(std::int64_t stamp_ns) {
    constexpr std::int64_t kInterval_ns = 500'000'000;
    return std::exchange(last_, stamp_ns / kInterval_ns) != stamp_ns / kInterval_ns;
  }

 private:
  std::optional<std::int64_t> last_;
};

/// Where something unplaced stands, so that nothing of the map is taken for what it shows: some way beside it, along x.
Vec3 place_beside(const MapState& map);

/// The boxes of its objects in the images of keyframes, by keyframe_id.
std::map<std::int64_t, AssociationFrame> boxes_in_keyframes(const MapState& map);

/// Takes the points of a map's sessions into a point map, which begins a further one beside them.
void restore_points(const MapState& map, PointMap* points);

/// The objects that points lie on: the confirmed one that a point is deepest in, within a tenth of its size.
/// @return for each point, the sparse ones first, the object's id, -1 for none
std::vector<std::int64_t> objects_under(const MapPoints& points, const MapState& map);

/// Leaves out what hangs on keyframes that the graph does not have: what came after the graph was saved last, or while
/// its stage did not keep up. Submaps are put where their keyframes are.
/// @return how many boxes, submaps, keyframes' points, merges and refused loops were left out
std::size_t leave_out_unplaced(MapState* map);

/// @return an error that names what does not fit together
Status check(const MapState& map);

}  // namespace semantic_topo_loop::core
