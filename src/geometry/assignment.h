#pragma once

#include <Eigen/Core>
#include <vector>

namespace semantic_topo_loop::core {

/// One-to-one assignment of rows to columns with the largest total score (Hungarian method by shortest augmenting
/// paths, Jonker and Volgenant 1987). Cubic in the smaller side; ties are decided by index, so that the same scores
/// always give the same assignment.
/// @param score any shape; an entry <= 0 or not finite forbids the pair, since leaving both free costs nothing
/// @return for each row its column, or -1
std::vector<int> assign_max(const Eigen::Ref<const Eigen::MatrixXd>& score);

}  // namespace semantic_topo_loop::core
