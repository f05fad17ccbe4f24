#pragma once

#include <ros/ros.h>

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>

#include "pipeline/map_state.h"
#include "ros/conversions.h"
#include "semantic_topo_loop/ros/messages.h"

namespace semantic_topo_loop {

/// Sends what is new in a stage's part of the map, twice a second of data and at the end, as long as somebody listens.
/// Every stage sends at the same frames, those whose corrections come first in their half second; who begins to listen
/// gets the whole part first.
class MapPartSender {
 public:
  explicit MapPartSender(std::uint8_t stage) : stage_(stage) {}

  void open(ros::NodeHandle node, std::size_t queue_size) {
    publisher_ = node.advertise<MapPartMessage>("map_parts", static_cast<std::uint32_t>(queue_size),
                                                [is_awaited = is_awaited_](const auto&) { *is_awaited = true; });
  }
  void reset_session() {
    save_points_ = core::SavePoints();
    end_frame_id_ = -1;
    *is_awaited_ = true;
  }
  void set_end(std::int64_t frame_id) { end_frame_id_ = frame_id; }

  /// A frame's correction has been taken in. @param take fills a MapDelta; its argument is whether that must be whole
  template <class Take>
  void follow(const std_msgs::Header& header, std::uint32_t session_id, std::int64_t frame_id, const Take& take) {
    const bool is_end = frame_id == end_frame_id_;
    const bool is_due = save_points_.is_due(to_stamp_ns(header.stamp)) || is_end;
    if (!is_due || publisher_.getNumSubscribers() == 0) return;
    MapPartValue part;
    part.frame_id = frame_id;
    part.stage = stage_;
    part.loaded = loaded_;
    part.is_end = is_end;
    auto delta = std::make_shared<core::MapDelta>();
    take(is_awaited_->exchange(false), delta.get());
    part.delta = std::move(delta);
    publisher_.publish(boost::make_shared<MapPartMessage>(header, session_id, std::move(part)));
  }

 private:
  const std::uint8_t stage_;
  /// Of the wall, which no bag's clock moves.
  const ros::Time loaded_{ros::WallTime::now().toSec()};
  ros::Publisher publisher_;
  core::SavePoints save_points_;
  std::int64_t end_frame_id_ = -1;
  /// By somebody who has not heard of the map yet. Shared: a callback may outlive this.
  std::shared_ptr<std::atomic<bool>> is_awaited_ = std::make_shared<std::atomic<bool>>(true);
};

}  // namespace semantic_topo_loop
