#include "semantic_topo_loop/types/landmark.h"

#include <array>

namespace semantic_topo_loop::core {

Mat3 Ellipsoid::shape() const {
  const Mat3 R = T_world_quadric.rotation();
  return R * semi_axes.cwiseAbs2().asDiagonal() * R.transpose();
}

Mat4 Ellipsoid::dual() const {
  const Mat4 Z = T_world_quadric.matrix();
  return Z *
         Vec4(semi_axes.x() * semi_axes.x(), semi_axes.y() * semi_axes.y(), semi_axes.z() * semi_axes.z(), -1.0)
             .asDiagonal() *
         Z.transpose();
}

const char* to_string(LandmarkState state) {
  constexpr std::array<const char*, 3> kNames = {"candidate", "confirmed", "retired"};
  const auto i = static_cast<std::size_t>(state);
  return i < kNames.size() ? kNames[i] : "unknown";
}

}  // namespace semantic_topo_loop::core
