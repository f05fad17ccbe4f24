#pragma once

#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/types/transform.h"
#include "tools/simulation/random.h"

namespace semantic_topo_loop::core {

/// Translation and rotation vector with the given sigmas on each axis.
inline Vec6 random_tangent(Random* random, double translation_m, double rotation_rad) {
  Vec6 tangent;
  tangent.head<3>() = translation_m * random->normal3();
  tangent.tail<3>() = rotation_rad * random->normal3();
  return tangent;
}

inline SE3 random_motion(Random* random, double translation_m, double rotation_rad) {
  return se3_exp(random_tangent(random, translation_m, rotation_rad));
}

}  // namespace semantic_topo_loop::core
