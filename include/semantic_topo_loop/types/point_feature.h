#pragma once

#include <array>
#include <cstdint>

#include "semantic_topo_loop/types/eigen.h"

namespace semantic_topo_loop::core {

/// 256 bits that tell what a point looks like (ORB: Rublee et al. 2011).
using Descriptor = std::array<std::uint64_t, 4>;

/// A point of the front end's map, and what it looks like.
struct PointFeature {
  std::int64_t id = -1;                                ///< the same in every image of a run that shows the point
  Eigen::Vector3f position = Eigen::Vector3f::Zero();  ///< m, in the camera's frame, or the submap's
  Descriptor descriptor{};
};

}  // namespace semantic_topo_loop::core
