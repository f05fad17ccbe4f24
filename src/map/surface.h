#pragma once

#include <Eigen/Core>
#include <vector>

namespace semantic_topo_loop::core {

/// What a frame saw of an object's near side: a few points spread over the middle of its box, camera frame, m.
using Surface = std::vector<Eigen::Vector3f>;

}  // namespace semantic_topo_loop::core
