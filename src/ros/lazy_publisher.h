#pragma once

#include <ros/publisher.h>

#include <cstdint>

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

}  // namespace semantic_topo_loop
