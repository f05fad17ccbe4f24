#include "ros/publishers.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "ros/conversions.h"

namespace semantic_topo_loop {

MapOdomSender::MapOdomSender(std::string map_frame, double tolerance_s)
    : map_frame_(std::move(map_frame)), tolerance_ns_(std::llround(tolerance_s * 1e9)) {}

void MapOdomSender::update(const core::SE3& T_map_odom, const ros::Time& stamp, const std::string& odom_frame) {
  const std::lock_guard<std::mutex> lock(mutex_);
  T_map_odom_ = T_map_odom;
  odom_frame_ = odom_frame;
  const std::int64_t stamp_ns = to_stamp_ns(stamp);
  if (stamp_ns < pose_stamp_ns_) sent_stamp_ns_ = -1;  // time went back, with a new session
  pose_stamp_ns_ = stamp_ns;
}

void MapOdomSender::send() {
  geometry_msgs::TransformStamped message;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (pose_stamp_ns_ < 0) return;
    // tf2 warns of a transform with the stamp of the one before: while no pose comes, one nanosecond makes it another.
    sent_stamp_ns_ = std::max(pose_stamp_ns_ + tolerance_ns_, sent_stamp_ns_ + 1);
    message.header.stamp = to_ros_time(sent_stamp_ns_);
    message.header.frame_id = map_frame_;
    message.child_frame_id = odom_frame_;
    message.transform = to_transform_msg(T_map_odom_);
  }
  broadcaster_.sendTransform(message);
}

}  // namespace semantic_topo_loop
