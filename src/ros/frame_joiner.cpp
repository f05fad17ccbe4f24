#include "ros/frame_joiner.h"

#include <algorithm>
#include <cstdlib>

#include "ros/conversions.h"

namespace semantic_topo_loop {
namespace {

std::int64_t stamp_of(const DetectionsMessage::ConstPtr& detections) { return to_stamp_ns(detections->header.stamp); }

}  // namespace

void DetectionMatcher::add(const DetectionsMessage::ConstPtr& detections) {
  const bool jumped_back = !waiting_.empty() && stamp_of(detections) < stamp_of(waiting_.back()) - kJumpBack_ns;
  if (jumped_back) {
    unmatched_ += waiting_.size();
    waiting_.clear();
  }
  waiting_.push_back(detections);
  if (waiting_.size() > capacity_) {
    ++unmatched_;
    waiting_.pop_front();
  }
}

DetectionsMessage::ConstPtr DetectionMatcher::take(std::int64_t stamp_ns) {
  const auto found = std::find_if(waiting_.begin(), waiting_.end(), [stamp_ns](const DetectionsMessage::ConstPtr& d) {
    return std::abs(stamp_of(d) - stamp_ns) <= kStampTolerance_ns;
  });
  if (found == waiting_.end()) return nullptr;
  const DetectionsMessage::ConstPtr detections = *found;
  waiting_.erase(found);
  const auto is_older = [stamp_ns](const DetectionsMessage::ConstPtr& d) { return stamp_of(d) < stamp_ns; };
  const auto end = std::remove_if(waiting_.begin(), waiting_.end(), is_older);
  unmatched_ += static_cast<std::uint64_t>(std::distance(end, waiting_.end()));
  waiting_.erase(end, waiting_.end());
  return detections;
}

}  // namespace semantic_topo_loop
