#pragma once

#include <image_transport/subscriber.h>
#include <message_filters/sync_policies/approximate_time.h>
#include <message_filters/synchronizer.h>
#include <ros/node_handle.h>
#include <sensor_msgs/Image.h>

#include <boost/function.hpp>
#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "ros/parameters.h"
#include "semantic_topo_loop/frontend/rgbd_image.h"

namespace semantic_topo_loop {

/// A copy of an image's pixels in an encoding of sensor_msgs, since they may be kept for longer than the message lives.
/// @param what "colour" or "depth", for the error, which names size and encoding
core::Result<cv::Mat> to_mat(const sensor_msgs::Image& image, const std::string& encoding, const char* what);

/// A colour image and its depth as the front end takes them: every colour encoding of cv_bridge, Bayer patterns and
/// mono8 included, and depth as 32FC1 (metres), 16UC1 or mono16. The stamp is the colour image's.
/// @return an error that names topic and value for an encoding or size that cannot be used
core::Result<core::RgbdImage> make_rgbd_image(const sensor_msgs::Image& color, const sensor_msgs::Image& depth,
                                              const core::Camera& camera, const core::DepthOptions& options);

/// Subscribes by image_transport, to the topic as it is remapped: the names that are made of it ("color/compressed")
/// have remappings of their own.
/// @param own namespace of the parameter TOPIC_transport and of the transport's own ones   @param transport its value
/// @return an error that names that parameter if the transport is misspelt or not installed
core::Result<image_transport::Subscriber> subscribe_to_images(
    const ros::NodeHandle& node, const ros::NodeHandle& own, const std::string& topic, const std::string& transport,
    std::uint32_t queue_size, const boost::function<void(const sensor_msgs::ImageConstPtr&)>& take);

/// Which depth image of a recording belongs to which colour image: the one nearest in stamp, `max_delay_s` away at
/// most, each once, and none that the next colour image is nearer to and has no nearer one than; a colour image
/// stamped after the next one gets none. The same recording gives the same pairs, whatever order its two topics were
/// recorded in.
class DepthPairing {
 public:
  struct Answer {
    ros::Time received;       ///< of the colour image
    std_msgs::Header header;  ///< of the colour image
    sensor_msgs::ImagePtr color;
    sensor_msgs::ImagePtr depth;  ///< null if none belongs to it
  };

  explicit DepthPairing(double max_delay_s) : max_delay_ns_(static_cast<std::int64_t>(1e9 * max_delay_s)) {}

  void add_color(const ros::Time& received, const sensor_msgs::ImagePtr& image) {
    colors_.push_back({received, image->header, image, {}});
  }
  void add_depth(const sensor_msgs::ImagePtr& image);
  /// No image will follow.
  void finish() { is_finished_ = true; }
  /// The next colour image, in the order in which they were added, once it is clear what belongs to it.
  std::optional<Answer> take();

 private:
  using Depths = std::map<std::int64_t, sensor_msgs::ImagePtr>;  ///< by stamp

  bool is_clear(std::int64_t color_ns) const;
  /// Of the first colour image that waits: the next one is between it and the last.
  bool is_ahead(std::int64_t color_ns) const;
  /// Of those before a stamp; its end if there is none within max_delay_s.
  Depths::iterator nearest(std::int64_t color_ns, std::int64_t before_ns);

  const std::int64_t max_delay_ns_;
  std::deque<Answer> colors_;
  Depths depths_;
  std::optional<std::int64_t> last_depth_ns_, last_color_ns_;
  bool is_finished_ = false;
};

/// Joins colour and depth images that arrive on topics, by message_filters' ApproximateTime, and accounts for those
/// that it cannot join. Not thread-safe.
class RgbdSynchronizer {
 public:
  using Clock = std::chrono::steady_clock;
  using ImageConstPtr = sensor_msgs::ImageConstPtr;
  using OnPair = std::function<void(const ImageConstPtr& color, const ImageConstPtr& depth)>;
  using OnSingle = std::function<void(std::int64_t stamp_ns)>;

  /// @param on_pair called for each pair, in order   @param on_single called for each colour image that stays alone
  RgbdSynchronizer(const PairingParameters& options, OnPair on_pair, OnSingle on_single);

  void add_color(const ImageConstPtr& image, Clock::time_point now);
  void add_depth(const ImageConstPtr& image, Clock::time_point now);
  /// Gives up colour images that have waited for too long.
  void expire(Clock::time_point now);
  /// No images have been awaited until now: that none came is no starvation.
  void excuse(Clock::time_point now) { excused_ = now; }
  /// Why no pairs come, with topics and stamps; empty while they do.
  std::string starvation(Clock::time_point now) const;

 private:
  using Policy = message_filters::sync_policies::ApproximateTime<sensor_msgs::Image, sensor_msgs::Image>;
  struct Topic {
    std::optional<std::int64_t> stamp_ns;  ///< of the last image
    Clock::time_point heard;               ///< when it came; at first, when listening began
  };

  /// ApproximateTime would wait for ever for the time before a jump back.
  void restart();
  void hear(const ImageConstPtr& image, Clock::time_point now, Topic* topic);
  void join(const ImageConstPtr& color, const ImageConstPtr& depth);
  std::string describe(const std::string& name, const Topic& topic, Clock::time_point now) const;

  const PairingParameters options_;
  const OnPair on_pair_;
  const OnSingle on_single_;
  std::unique_ptr<message_filters::Synchronizer<Policy>> synchronizer_;
  std::map<std::int64_t, Clock::time_point> waiting_;  ///< colour images without depth so far, and when they came
  Topic color_, depth_;
  Clock::time_point paired_;        ///< when the last pair was complete
  Clock::time_point excused_ = {};  ///< silence counts from here on
};

}  // namespace semantic_topo_loop
