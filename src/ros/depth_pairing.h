#pragma once

#include <sensor_msgs/Image.h>

#include <cstdint>
#include <deque>
#include <map>
#include <optional>

namespace semantic_topo_loop {

/// Which depth image of a recording belongs to which colour image: the one nearest in stamp, `max_delay_s` away at
/// most, each once. The same recording gives the same pairs, whatever order its two topics were recorded in.
class DepthPairing {
 public:
  struct Answer {
    ros::Time received;  ///< of the colour image
    sensor_msgs::ImagePtr color;
    sensor_msgs::ImagePtr depth;  ///< null if none belongs to it
  };

  explicit DepthPairing(double max_delay_s) : max_delay_ns_(static_cast<std::int64_t>(1e9 * max_delay_s)) {}

  void add_color(const ros::Time& received, const sensor_msgs::ImagePtr& image) {
    colors_.push_back({received, image, {}});
  }
  void add_depth(const sensor_msgs::ImagePtr& image);
  /// No image will follow.
  void finish() { is_finished_ = true; }
  /// The next colour image, in the order in which they were added, once it is clear what belongs to it.
  std::optional<Answer> take();

 private:
  bool is_clear(std::int64_t color_ns) const;

  const std::int64_t max_delay_ns_;
  std::deque<Answer> colors_;
  std::map<std::int64_t, sensor_msgs::ImagePtr> depths_;  ///< by stamp
  std::optional<std::int64_t> newest_depth_ns_;
  bool is_finished_ = false;
};

}  // namespace semantic_topo_loop
