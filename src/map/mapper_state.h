#pragma once

#include <cstdint>
#include <vector>

#include "map/mapped_landmark.h"
#include "semantic_topo_loop/types/camera.h"

namespace semantic_topo_loop::core {

/// What is new in a landmark.
struct LandmarkDelta {
  LandmarkRecord record;
  std::size_t first = 0;                  ///< number of the first of `observations`; those before are as they were
  std::vector<Observation> observations;  ///< all from there on
};

/// What is new in a map of objects.
struct MapperDelta {
  bool is_whole = true;  ///< what is not in it is not in the map
  Camera camera;
  std::vector<LandmarkDelta> changed;  ///< in order of id
  std::vector<std::int64_t> removed;   ///< ids
};

/// All that a later session needs of a map of objects to go on with it. Merges are settled: they are not taken back.
struct MapperState {
  Camera camera;                          ///< whose pixels the observations' boxes are in
  std::vector<MappedLandmark> landmarks;  ///< in order of id
};

/// Takes a landmark's boxes from the pixels of one camera to those of another, which sees along the same rays.
/// @return false, and all as it was, if their pixels are the same
bool move_boxes(const Camera& from, const Camera& to, MappedLandmark* landmark);

}  // namespace semantic_topo_loop::core
