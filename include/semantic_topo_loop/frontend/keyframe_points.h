#pragma once

#include <Eigen/Core>
#include <vector>

#include "semantic_topo_loop/frontend/rgbd_image.h"

namespace semantic_topo_loop::core {

/// Points on the edges of an image: in each cell of an even grid the pixel of the steepest grey level, if it is steep
/// and has a depth. Where depth jumps, the nearer side is taken: an outline belongs to what is in front.
/// @param count_max about so many at most, by the size of the cells   @return camera frame, m, row by row
std::vector<Eigen::Vector3f> semi_dense_points(const RgbdImage& image, const Camera& camera, int count_max);

}  // namespace semantic_topo_loop::core
