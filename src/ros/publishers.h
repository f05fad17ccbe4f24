#pragma once

#include <ros/publisher.h>
#include <ros/time.h>
#include <tf2_ros/transform_broadcaster.h>

#include <cstdint>
#include <mutex>
#include <string>

#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop {

/// Publishes something costly only when somebody listens and has not seen it. Not thread-safe.
class LazyPublisher {
 public:
  void open(const ros::Publisher& publisher) { publisher_ = publisher; }
  bool has_listeners() const { return publisher_.getNumSubscribers() > 0; }
  void mark_changed() { changed_ = true; }
  /// Somebody listens, and the content changed or a listener came since the last publish.
  bool is_due() {
    const std::uint32_t listeners = publisher_.getNumSubscribers();
    if (listeners > listeners_) changed_ = true;
    listeners_ = listeners;
    return listeners > 0 && changed_;
  }
  template <class MessagePtr>
  void publish(const MessagePtr& message) {
    changed_ = false;
    publisher_.publish(message);
  }

 private:
  ros::Publisher publisher_;
  std::uint32_t listeners_ = 0;
  bool changed_ = false;
};

/// Sends map -> odom at a fixed rate, whatever the pose graph is doing. Thread-safe.
class MapOdomSender {
 public:
  /// @param tolerance_s how far the transform is dated ahead of the last pose, so that listeners need not wait
  MapOdomSender(std::string map_frame, double tolerance_s);

  void update(const core::SE3& T_map_odom, const ros::Time& stamp, const std::string& odom_frame);
  /// Call at the wanted rate. Nothing is sent before the first pose.
  void send();

 private:
  const std::string map_frame_;
  const std::int64_t tolerance_ns_;
  tf2_ros::TransformBroadcaster broadcaster_;
  std::mutex mutex_;  ///< guards all below
  core::SE3 T_map_odom_;
  std::string odom_frame_;
  std::int64_t pose_stamp_ns_ = -1;
  std::int64_t sent_stamp_ns_ = -1;
};

}  // namespace semantic_topo_loop
