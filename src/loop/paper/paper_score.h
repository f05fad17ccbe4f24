#pragma once

#include <string>
#include <vector>

#include "semantic_topo_loop/types/eigen.h"

namespace semantic_topo_loop::core {

/// A landmark that two keyframes share: its centre in each camera frame, estimated by each keyframe for itself.
struct CommonNode {
  Vec3 center_query = Vec3::Zero();
  Vec3 center_match = Vec3::Zero();
  double quality = 1.0;  ///< rho in [0, 1]
};

/// How one semantic vector (from node i to node j) of the query lies in the match:
/// c_match = scale * R * c_query + t for both ends, with R the least rotation between the two vectors.
struct VectorTransform {
  Mat3 R = Mat3::Identity();
  double scale = 1.0;
  double angle_rad = 0.0;  ///< of R, [0, pi]
  Vec3 t = Vec3::Zero();   ///< m
};

/// The least rotation that turns the direction of `from` into that of `to`, by Rodrigues' formula with the unit axis;
/// exact at angle 0, and at pi about an arbitrary but fixed perpendicular axis.
Mat3 rotation_between(const Vec3& from, const Vec3& to);

/// R, s, t of the semantic vector from `start` to `end` (SemanticTopoLoop, QLT-SLC).
VectorTransform vector_transform(const CommonNode& start, const CommonNode& end);

/// The score as it is described in the paper: the sum over the pairs of nodes of
/// rho exp(-|s ||R|| + ||t|| - 1| / 2) with the spectral norm of R. It is kept for the record: ||R|| is 1 for every
/// rotation, so that none is measured; s = 0.5 with ||t|| = 0.5 m scores like identity; and the sum grows with n^2.
double printed_score(const std::vector<CommonNode>& nodes);

/// Mean over the pairs of nodes of rho exp(-(|1 - s| + theta + ||t||) / 2), in [0, 1]; 1 for identity and rho = 1.
double corrected_score(const std::vector<CommonNode>& nodes);

}  // namespace semantic_topo_loop::core
