#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace semantic_topo_loop::core {

/// A point of the front end's map, as a keyframe sees it.
struct SparsePoint {
  std::int64_t id = -1;                                    ///< of the point, the same in every keyframe that sees it
  Eigen::Vector3f point_camera = Eigen::Vector3f::Zero();  ///< m
};

/// The points that a keyframe adds to the map. No image is kept.
struct KeyframePoints {
  std::vector<SparsePoint> sparse;          ///< in order of id
  std::vector<Eigen::Vector3f> semi_dense;  ///< on edges of the image, camera frame, m
};

}  // namespace semantic_topo_loop::core
