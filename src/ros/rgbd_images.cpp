#include "ros/rgbd_images.h"

#include <cv_bridge/cv_bridge.h>
#include <image_transport/exception.h>
#include <image_transport/image_transport.h>
#include <sensor_msgs/image_encodings.h>

#include <algorithm>
#include <boost/bind/bind.hpp>
#include <cstdint>
#include <cstdlib>
#include <exception>
#include <iterator>
#include <limits>
#include <utility>

#include "ros/conversions.h"
#include "semantic_topo_loop/types/stamp.h"
#include "semantic_topo_loop/types/text.h"

namespace semantic_topo_loop {
namespace {

namespace encodings = sensor_msgs::image_encodings;

/// Colour images that wait for a depth topic which has fallen silent.
constexpr std::size_t kMaxWaiting = 30;

double seconds_between(RgbdSynchronizer::Clock::time_point begin, RgbdSynchronizer::Clock::time_point end) {
  return std::chrono::duration<double>(end - begin).count();
}

std::string format_seconds(double seconds) { return core::format_fixed(seconds, 3) + " s"; }

}  // namespace

core::Result<cv::Mat> to_mat(const sensor_msgs::Image& image, const std::string& encoding, const char* what) {
  const auto error = [&image, what](const std::string& cause) {
    return core::Error{std::string(what) + " image, " + std::to_string(image.width) + " x " +
                       std::to_string(image.height) + ", encoding '" + image.encoding + "': " + cause};
  };
  // cv_bridge multiplies in 32 bits, so that it takes some sizes which the data does not have.
  if (image.width > image.step || std::uint64_t{image.step} * image.height > image.data.size()) {
    return error(std::to_string(image.data.size()) + " bytes in rows of " + std::to_string(image.step));
  }
  try {
    return cv_bridge::toCvCopy(image, encoding)->image;
  } catch (const std::exception& exception) {
    // cv_bridge's own exceptions, and OpenCV's for sizes that a pattern cannot have.
    return error(exception.what());
  }
}

core::Result<core::RgbdImage> make_rgbd_image(const sensor_msgs::Image& color, const sensor_msgs::Image& depth,
                                              const core::Camera& camera, const core::DepthOptions& options) {
  const core::Result<cv::Mat> gray = to_mat(color, encodings::MONO8, "colour");
  if (!gray) return gray.error();
  if (depth.encoding != encodings::TYPE_32FC1 && depth.encoding != encodings::TYPE_16UC1 &&
      depth.encoding != encodings::MONO16) {
    return core::Error{"depth image of encoding '" + depth.encoding + "', which must be 32FC1 or 16UC1"};
  }
  const core::Result<cv::Mat> distance = to_mat(depth, depth.encoding, "depth");
  if (!distance) return distance.error();
  return core::make_rgbd_image(to_stamp_ns(color.header.stamp), *gray, *distance, camera, options);
}

core::Result<image_transport::Subscriber> subscribe_to_images(
    const ros::NodeHandle& node, const ros::NodeHandle& own, const std::string& topic, const std::string& transport,
    std::uint32_t queue_size, const boost::function<void(const sensor_msgs::ImageConstPtr&)>& take) {
  const std::string parameter = topic + "_transport";
  try {
    return image_transport::ImageTransport(node).subscribe(node.resolveName(topic), queue_size, take, ros::VoidPtr(),
                                                           {transport, {}, own, parameter});
  } catch (const image_transport::Exception& exception) {
    std::string cause = exception.what();
    std::replace(cause.begin(), cause.end(), '\n', ' ');
    return core::Error{"parameter '" + parameter + "' = '" + transport + "': " + cause};
  }
}

void DepthPairing::add_depth(const sensor_msgs::ImagePtr& image) {
  const std::int64_t stamp_ns = to_stamp_ns(image->header.stamp);
  depths_.emplace(stamp_ns, image);
  if (depths_.size() > kMaxWaiting) depths_.erase(depths_.begin());
  last_depth_ns_ = stamp_ns;  // the last one: one far ahead does not make clear what follows
}

bool DepthPairing::is_clear(std::int64_t color_ns) const {
  return is_finished_ || colors_.size() > kMaxWaiting ||
         (last_depth_ns_ && *last_depth_ns_ >= color_ns + max_delay_ns_);
}

bool DepthPairing::is_ahead(std::int64_t color_ns) const {
  if (colors_.size() < 2) return false;
  const std::int64_t next_ns = to_stamp_ns(colors_[1].color->header.stamp);
  return next_ns < color_ns && (!last_color_ns_ || next_ns > *last_color_ns_);
}

DepthPairing::Depths::iterator DepthPairing::nearest(std::int64_t color_ns, std::int64_t before_ns) {
  const auto end = depths_.lower_bound(std::min(before_ns, color_ns + max_delay_ns_ + 1));
  const auto nearest = std::min_element(
      depths_.lower_bound(color_ns - max_delay_ns_), end,
      [color_ns](const auto& a, const auto& b) { return std::abs(a.first - color_ns) < std::abs(b.first - color_ns); });
  return nearest == end ? depths_.end() : nearest;
}

std::optional<DepthPairing::Answer> DepthPairing::take() {
  // Where colour pauses, the depth that belongs to this image would not be kept for as long.
  const bool may_wait = !is_finished_ && depths_.size() < kMaxWaiting;
  if (colors_.empty() || (colors_.size() == 1 && may_wait)) return std::nullopt;
  constexpr std::int64_t kAny = std::numeric_limits<std::int64_t>::max();
  const std::int64_t color_ns = to_stamp_ns(colors_.front().color->header.stamp);
  if (is_ahead(color_ns)) {
    // Waiting for its depth would cost those after it theirs.
    Answer ahead = colors_.front();
    colors_.pop_front();
    return ahead;
  }
  if (!is_clear(color_ns)) return std::nullopt;
  auto own = nearest(color_ns, kAny);
  if (own != depths_.end() && colors_.size() > 1) {
    const std::int64_t next_ns = to_stamp_ns(colors_[1].color->header.stamp);
    if (std::abs(own->first - next_ns) < std::abs(own->first - color_ns)) {
      if (!is_clear(next_ns)) return std::nullopt;
      if (nearest(next_ns, kAny) == own) own = nearest(color_ns, own->first);
    }
  }
  Answer answer = colors_.front();
  colors_.pop_front();
  last_color_ns_ = color_ns;
  if (own == depths_.end()) {
    depths_.erase(depths_.begin(), depths_.lower_bound(color_ns - max_delay_ns_));
    return answer;
  }
  answer.depth = own->second;
  depths_.erase(depths_.begin(), std::next(own));
  return answer;
}

RgbdSynchronizer::RgbdSynchronizer(const PairingParameters& options, OnPair on_pair, OnSingle on_single)
    : options_(options), on_pair_(std::move(on_pair)), on_single_(std::move(on_single)) {
  color_.heard = depth_.heard = paired_ = Clock::now();
  restart();
}

void RgbdSynchronizer::restart() {
  Policy policy(static_cast<std::uint32_t>(options_.queue_size));
  policy.setMaxIntervalDuration(ros::Duration(options_.max_delay_s));
  synchronizer_ = std::make_unique<message_filters::Synchronizer<Policy>>(policy);
  synchronizer_->registerCallback(
      boost::bind(&RgbdSynchronizer::join, this, boost::placeholders::_1, boost::placeholders::_2));
  for (const auto& [stamp_ns, since] : std::exchange(waiting_, {})) on_single_(stamp_ns);
  color_.stamp_ns.reset();
  depth_.stamp_ns.reset();
}

void RgbdSynchronizer::hear(const ImageConstPtr& image, Clock::time_point now, Topic* topic) {
  const std::int64_t stamp_ns = to_stamp_ns(image->header.stamp);
  // message_filters takes differences as ros::Duration, which throws beyond 2^31 s.
  constexpr std::int64_t kFarthest_ns = 1'000'000'000'000'000'000;
  const auto is_far = [stamp_ns](const Topic& other) {
    return other.stamp_ns && std::abs(stamp_ns - *other.stamp_ns) > kFarthest_ns;
  };
  const bool jumped_back = topic->stamp_ns && stamp_ns < *topic->stamp_ns - kJumpBack_ns;
  if (jumped_back || is_far(color_) || is_far(depth_)) restart();
  topic->stamp_ns = stamp_ns;
  topic->heard = now;
}

void RgbdSynchronizer::add_color(const ImageConstPtr& image, Clock::time_point now) {
  hear(image, now, &color_);
  waiting_[*color_.stamp_ns] = now;
  synchronizer_->add<0>(ros::MessageEvent<sensor_msgs::Image const>(image, image->header.stamp));
}

void RgbdSynchronizer::add_depth(const ImageConstPtr& image, Clock::time_point now) {
  hear(image, now, &depth_);
  synchronizer_->add<1>(ros::MessageEvent<sensor_msgs::Image const>(image, image->header.stamp));
}

void RgbdSynchronizer::join(const ImageConstPtr& color, const ImageConstPtr& depth) {
  const auto own = waiting_.find(to_stamp_ns(color->header.stamp));
  if (own == waiting_.end()) return;  // given up already
  paired_ = Clock::now();
  // Pairs come in order: what is older stays alone.
  while (waiting_.begin() != own) {
    on_single_(waiting_.begin()->first);
    waiting_.erase(waiting_.begin());
  }
  waiting_.erase(own);
  on_pair_(color, depth);
}

void RgbdSynchronizer::expire(Clock::time_point now) {
  while (!waiting_.empty() && seconds_between(waiting_.begin()->second, now) > options_.pair_timeout_s) {
    on_single_(waiting_.begin()->first);
    waiting_.erase(waiting_.begin());
  }
}

std::string RgbdSynchronizer::describe(const std::string& name, const Topic& topic, Clock::time_point now) const {
  if (!topic.stamp_ns) return "'" + name + "': no image yet";
  return "'" + name + "': last image " + format_seconds(seconds_between(topic.heard, now)) + " ago, stamp " +
         core::format_stamp(*topic.stamp_ns);
}

std::string RgbdSynchronizer::starvation(Clock::time_point now) const {
  const auto is_silent = [this, now](Clock::time_point heard) {
    return seconds_between(std::max(heard, excused_), now) > options_.starvation_s;
  };
  std::string who;
  if (is_silent(color_.heard)) who = "'" + options_.color_topic + "'";
  if (is_silent(depth_.heard)) who += (who.empty() ? "'" : " and '") + options_.depth_topic + "'";
  if (!who.empty()) {
    who = "no images on " + who;
  } else if (is_silent(paired_)) {
    who = "images on both topics, but none within " + format_seconds(options_.max_delay_s) + " of each other";
  } else {
    return {};
  }
  if (color_.stamp_ns && depth_.stamp_ns) {
    who += "; gap between the last stamps " +
           format_seconds(1e-9 * static_cast<double>(*color_.stamp_ns - *depth_.stamp_ns));
  }
  return who + "; " + describe(options_.color_topic, color_, now) + "; " + describe(options_.depth_topic, depth_, now);
}

}  // namespace semantic_topo_loop
