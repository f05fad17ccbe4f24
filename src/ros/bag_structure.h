#pragma once

#include <string>

#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop {

/// Whether the records of a bag (ROS bag format 2.0) end within it and stand where its index says. rosbag trusts the
/// index and reads past its buffers where a damaged one leads. What is compressed has checksums of its own, and a bag
/// without an index is left to rosbag to refuse.
/// @return an error that says at which byte the bag is damaged, or that it cannot be opened
core::Status check_bag_structure(const std::string& file);

}  // namespace semantic_topo_loop
