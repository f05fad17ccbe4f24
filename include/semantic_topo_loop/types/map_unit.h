#pragma once

#include <optional>
#include <vector>

#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/landmark.h"

namespace semantic_topo_loop::core {

/// How long a map's unit of length is: 1 m, unless the odometry, a monocular one say, has a unit of its own.
struct MapUnit {
  double metres = 1.0;
  double sigma = 0.0;            ///< of log(metres), which is the relative error
  int objects = 0, classes = 0;  ///< that tell
};

/// The unit by the typical sizes of classes: robust mean (Cauchy) over classes of log(typical diameter / diameter), a
/// diameter being twice the root mean square of an ellipsoid's semi-axes. Confirmed objects alone.
/// @return nullopt for fewer than three classes: one that is larger here than elsewhere would be outvoted by none
std::optional<MapUnit> map_unit(const std::vector<Landmark>& landmarks, const ClassTable& classes);

}  // namespace semantic_topo_loop::core
