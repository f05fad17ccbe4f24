#include "semantic_topo_loop/types/ellipsoid.h"

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

}  // namespace semantic_topo_loop::core
