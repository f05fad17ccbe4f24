#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/landmark.h"
#include "semantic_topo_loop/types/map_correction.h"

namespace semantic_topo_loop::core {

struct MapperDelta;
struct MapperState;
struct QuadricMapperOptions;

/// The quadric map: alone owns geometry, state and merges of the landmarks.
class QuadricMapper {
 public:
  QuadricMapper(const QuadricMapperOptions& options, std::shared_ptr<const ClassTable> classes);

  /// Takes in a frame's associations; initialises, refines, merges, confirms and retires landmarks. The end frame
  /// changes nothing as yet: the correction of that frame comes first.
  MapUpdate integrate(const Frame& frame, const AssociationFrame& associations);
  /// Moves landmarks with their keyframes and takes over map_from_odom, in one version; ends the frame.
  /// The correction of the end frame finishes the map: all landmarks are fitted on all views, duplicates and parts go.
  MapUpdate apply(const MapCorrection& correction);
  /// Every landmark that has not been merged away or given up, in order of id.
  std::vector<Landmark> landmarks() const;
  /// Stamp of the last image with a box of the landmark, ns; nullopt if there is no such landmark.
  std::optional<std::int64_t> last_seen_ns(std::int64_t landmark_id) const;
  /// While the map is fixed, what is seen changes nothing in it; corrections still move it.
  void set_fixed(bool fixed);
  /// From the next update on, in which every landmark is judged anew. @param options those that it has, but for live
  /// ones
  void set_options(const QuadricMapperOptions& options);
  std::uint64_t map_version() const;
  const SE3& T_map_odom() const;
  /// What a later session goes on with (src/map/mapper_state.h).
  MapperState state() const;
  /// What is new since the last call, or all there is. @param whole also if it was told before
  MapperDelta take_delta(bool whole);
  /// Goes on with earlier sessions' objects. Call it before the first frame.
  /// @param keyframes that they hang on   @param begin_at where this session's first camera stands for now, as
  /// PoseGraph::restore has it   @return all of them, for those who follow the map
  MapUpdate restore(MapperState state, const std::vector<KeyframePose>& keyframes,
                    const std::optional<Vec3>& begin_at = {});

 private:
  struct Impl;
  std::unique_ptr<Impl, void (*)(Impl*)> impl_;
};

}  // namespace semantic_topo_loop::core
