#pragma once

#include <ceres/ceres.h>
#include <ceres/version.h>

namespace semantic_topo_loop::core {

/// Keeps a parameter block of four doubles in Eigen's order (x, y, z, w) on the unit quaternions. The update is
/// q <- delta * q, a rotation of twice the tangent vector in the outer frame, in every Ceres version.
///
/// Ceres 2.1 brought manifolds and 2.2 took local parameterizations away; this is the only place that knows.
/// @param q must have been added to the problem, alone or by a residual block; the problem owns what is set
inline void set_quaternion_manifold(ceres::Problem& problem, double* q) {
#if CERES_VERSION_MAJOR > 2 || (CERES_VERSION_MAJOR == 2 && CERES_VERSION_MINOR >= 1)
  problem.SetManifold(q, new ceres::EigenQuaternionManifold);
#else
  problem.SetParameterization(q, new ceres::EigenQuaternionParameterization);
#endif
}

}  // namespace semantic_topo_loop::core
