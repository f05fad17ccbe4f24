#include "semantic_topo_loop/ros/player_source.h"

#include "semantic_topo_loop/ros/conversions.h"

namespace semantic_topo_loop {

std::optional<PlayerItem> FileStamps::next(std::string* /*error*/) {
  if (index_ == trajectory_.size()) return std::nullopt;
  PlayerItem item;
  item.camera_info = camera_info_;
  item.camera_info.header.stamp = to_ros_time(trajectory_[index_++].stamp_ns);
  return item;
}

}  // namespace semantic_topo_loop
