#include "ros/rgbd_synchronizer.h"

#include <boost/bind/bind.hpp>
#include <cstdio>
#include <utility>

#include "ros/conversions.h"
#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop {
namespace {

double seconds_between(RgbdSynchronizer::Clock::time_point begin, RgbdSynchronizer::Clock::time_point end) {
  return std::chrono::duration<double>(end - begin).count();
}

std::string format_seconds(double seconds) {
  char text[32];
  std::snprintf(text, sizeof(text), "%.3f s", seconds);
  return text;
}

}  // namespace

RgbdSynchronizer::RgbdSynchronizer(const Options& options, OnPair on_pair, OnSingle on_single)
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
  if (topic->stamp_ns && stamp_ns < *topic->stamp_ns - kJumpBack_ns) restart();
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
    return seconds_between(heard, now) > options_.starvation_s;
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
