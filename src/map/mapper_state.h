#pragma once

#include <vector>

#include "map/mapped_landmark.h"
#include "semantic_topo_loop/types/camera.h"

namespace semantic_topo_loop::core {

/// All that a later session needs of a map of objects to go on with it. Merges are settled: they are not taken back.
struct MapperState {
  Camera camera;                          ///< whose pixels the observations' boxes are in
  std::vector<MappedLandmark> landmarks;  ///< in order of id

  /// Takes the boxes to the pixels of another camera, which sees along the same rays.
  void move_to(const Camera& other);
};

}  // namespace semantic_topo_loop::core
