#include "ros/depth_pairing.h"

#include <algorithm>
#include <cstdlib>

#include "ros/conversions.h"

namespace semantic_topo_loop {
namespace {

/// Colour images that wait for a depth topic which has fallen silent.
constexpr std::size_t kMaxWaiting = 30;

}  // namespace

void DepthPairing::add_depth(const sensor_msgs::ImagePtr& image) {
  const std::int64_t stamp_ns = to_stamp_ns(image->header.stamp);
  depths_.emplace(stamp_ns, image);
  if (depths_.size() > kMaxWaiting) depths_.erase(depths_.begin());
  newest_depth_ns_ = std::max(stamp_ns, newest_depth_ns_.value_or(stamp_ns));
}

bool DepthPairing::is_clear(std::int64_t color_ns) const {
  return is_finished_ || colors_.size() > kMaxWaiting ||
         (newest_depth_ns_ && *newest_depth_ns_ >= color_ns + max_delay_ns_);
}

std::optional<DepthPairing::Answer> DepthPairing::take() {
  if (colors_.empty()) return std::nullopt;
  const std::int64_t color_ns = to_stamp_ns(colors_.front().color->header.stamp);
  if (!is_clear(color_ns)) return std::nullopt;
  Answer answer = colors_.front();
  colors_.pop_front();
  const auto begin = depths_.lower_bound(color_ns - max_delay_ns_);
  const auto end = depths_.upper_bound(color_ns + max_delay_ns_);
  const auto nearest = std::min_element(begin, end, [color_ns](const auto& a, const auto& b) {
    return std::abs(a.first - color_ns) < std::abs(b.first - color_ns);
  });
  if (nearest == end) {
    depths_.erase(depths_.begin(), begin);
    return answer;
  }
  answer.depth = nearest->second;
  depths_.erase(depths_.begin(), std::next(nearest));
  return answer;
}

}  // namespace semantic_topo_loop
