#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "semantic_topo_loop/ros/messages.h"

namespace semantic_topo_loop {

/// Detections that arrived on a topic, waiting for the frame of their image. Bounded; not thread-safe.
class DetectionMatcher {
 public:
  explicit DetectionMatcher(std::size_t capacity) : capacity_(capacity) {}

  /// Time that jumps back by more than a second makes what waits worthless.
  void add(const DetectionsMessage::ConstPtr& detections);
  /// The detections of the image with this stamp (within 1 us), which are then gone, as are older ones: frames come in
  /// order.
  DetectionsMessage::ConstPtr take(std::int64_t stamp_ns);
  /// Detections that no frame ever asked for, or only before they came.
  std::uint64_t unmatched() const { return unmatched_; }

 private:
  const std::size_t capacity_;
  std::deque<DetectionsMessage::ConstPtr> waiting_;  ///< in order of arrival
  std::uint64_t unmatched_ = 0;
};

}  // namespace semantic_topo_loop
