#pragma once

#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core::testing {

/// A camera at `position` that looks at `target`, its y axis pointing down (world z up).
inline SE3 look_at(const Vec3& position, const Vec3& target) {
  const Vec3 z = (target - position).normalized();
  const Vec3 x = z.cross(Vec3::UnitZ()).normalized();
  Mat3 R;
  R << x, z.cross(x), z;
  return {R, position};
}

}  // namespace semantic_topo_loop::core::testing
