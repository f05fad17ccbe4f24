#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <tuple>
#include <utility>

#include "ros/conversions.h"
#include "semantic_topo_loop/types/detection.h"

namespace semantic_topo_loop {

/// Joins one message of each kind by frame_id, in order of frame_id. When a frame completes, older incomplete ones are
/// evicted: nothing may be processed before a frame that was already processed. Not thread-safe.
template <class... Kinds>
class FrameJoiner {
 public:
  using Set = std::tuple<Kinds...>;
  using Partial = std::tuple<std::optional<Kinds>...>;
  using EvictHandler = std::function<void(std::int64_t frame_id, const Partial& partial)>;

  /// @param capacity incomplete frames held; the oldest is evicted beyond   @param on_evict called oldest first
  explicit FrameJoiner(std::size_t capacity, EvictHandler on_evict = {})
      : capacity_(capacity), on_evict_(std::move(on_evict)) {}

  /// Adds the message of kind `I`.
  /// @return the complete set if this message was the last one missing
  template <std::size_t I>
  std::optional<Set> add(std::int64_t frame_id, std::tuple_element_t<I, Set> message) {
    if (is_past(frame_id)) return std::nullopt;
    Partial& partial = pending_[frame_id];
    std::get<I>(partial) = std::move(message);
    if (!is_complete(partial)) {
      if (pending_.size() > capacity_) evict_oldest();
      return std::nullopt;
    }
    Set set = std::apply([](auto&... items) { return Set(std::move(*items)...); }, partial);
    pending_.erase(frame_id);
    evict_before(frame_id);
    last_frame_id_ = frame_id;
    return set;
  }

  void clear() {
    pending_.clear();
    last_frame_id_ = kNone;
  }
  /// The frame was complete or evicted already: what still comes of it is not joined.
  bool is_past(std::int64_t frame_id) const { return frame_id <= last_frame_id_; }
  /// Incomplete frames given up.
  std::uint64_t evicted() const { return evicted_; }
  std::size_t size() const { return pending_.size(); }

 private:
  static constexpr std::int64_t kNone = -1;

  static bool is_complete(const Partial& partial) {
    return std::apply([](const auto&... items) { return (items.has_value() && ...); }, partial);
  }
  void evict_oldest() {
    const auto oldest = pending_.extract(pending_.begin());
    last_frame_id_ = oldest.key();
    ++evicted_;
    if (on_evict_) on_evict_(oldest.key(), oldest.mapped());
  }
  void evict_before(std::int64_t frame_id) {
    while (!pending_.empty() && pending_.begin()->first < frame_id) evict_oldest();
  }

  std::size_t capacity_;
  EvictHandler on_evict_;
  std::map<std::int64_t, Partial> pending_;
  std::int64_t last_frame_id_ = kNone;
  std::uint64_t evicted_ = 0;
};

/// Detections that arrived on a topic, waiting for the frame of their image. Bounded; not thread-safe.
class DetectionMatcher {
 public:
  explicit DetectionMatcher(std::size_t capacity) : capacity_(capacity) {}

  /// Time that jumps back by more than a second makes what waits worthless.
  void add(core::DetectionFrame detections) {
    if (!waiting_.empty() && detections.stamp_ns < waiting_.back().stamp_ns - kJumpBack_ns) {
      unmatched_ += waiting_.size();
      waiting_.clear();
    }
    waiting_.push_back(std::move(detections));
    if (waiting_.size() > capacity_) {
      ++unmatched_;
      waiting_.pop_front();
    }
  }

  /// The detections of the image with this stamp (within 1 us), which are then gone.
  std::optional<core::DetectionFrame> take(std::int64_t stamp_ns) {
    const auto found = std::find_if(waiting_.begin(), waiting_.end(), [stamp_ns](const core::DetectionFrame& d) {
      return std::abs(d.stamp_ns - stamp_ns) <= kStampTolerance_ns;
    });
    if (found == waiting_.end()) return std::nullopt;
    std::optional<core::DetectionFrame> detections = std::move(*found);
    waiting_.erase(found);
    return detections;
  }

  /// The frame of this stamp waits no longer: what is older will stay alone, for frames come in order.
  void forget_before(std::int64_t stamp_ns) {
    const auto is_older = [stamp_ns](const core::DetectionFrame& d) { return d.stamp_ns < stamp_ns; };
    const auto end = std::remove_if(waiting_.begin(), waiting_.end(), is_older);
    unmatched_ += static_cast<std::uint64_t>(std::distance(end, waiting_.end()));
    waiting_.erase(end, waiting_.end());
  }

  /// Whether a later image's detections are there: a detector answers in order, so this one's will not come. What is
  /// more than a second later is of another time.
  bool is_past(std::int64_t stamp_ns) const {
    return std::any_of(waiting_.begin(), waiting_.end(), [stamp_ns](const core::DetectionFrame& d) {
      return d.stamp_ns > stamp_ns + kStampTolerance_ns && d.stamp_ns <= stamp_ns + kJumpBack_ns;
    });
  }

  /// Detections that no frame ever asked for, or only before they came.
  std::uint64_t unmatched() const { return unmatched_; }

 private:
  const std::size_t capacity_;
  std::deque<core::DetectionFrame> waiting_;  ///< in order of arrival
  std::uint64_t unmatched_ = 0;
};

}  // namespace semantic_topo_loop
