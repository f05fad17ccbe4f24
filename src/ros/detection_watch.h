#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>

namespace semantic_topo_loop {

/// Notices when frames and detections do not meet: one of the topics is silent while messages come on the other, the
/// stamps are never the same, or a detector's answers come when nobody waits for them any more. Not thread-safe.
class DetectionWatch {
 public:
  using Clock = std::chrono::steady_clock;

  /// @param frames, detections names of the topics
  DetectionWatch(const std::string& frames, const std::string& detections) {
    frames_.name = frames;
    detections_.name = detections;
  }

  void hear_frame(std::int64_t stamp_ns, Clock::time_point now) { hear(stamp_ns, now, &frames_); }
  /// Of an image that the detector looked at.
  void hear_detections(std::int64_t stamp_ns, Clock::time_point now) { hear(stamp_ns, now, &detections_); }
  /// A frame has found its detections.
  void meet() {
    frames_.alone_since.reset();
    detections_.alone_since.reset();
  }
  /// A frame has found that the detector leaves its image out: somebody is there, who may yet be too late with others.
  void meet_unanswered() { frames_.alone_since.reset(); }
  /// What has been alone for 3 s, with topics and stamps; empty while nothing is.
  std::string starvation(Clock::time_point now) const;

 private:
  struct Topic {
    std::string name;
    std::optional<std::int64_t> stamp_ns;          ///< of the last message
    Clock::time_point heard{};                     ///< when that came
    std::optional<Clock::time_point> alone_since;  ///< when the first message came after the last meeting or silence
  };
  /// Long enough for a detector that loads its model at the first image, and well within the 5 s that a user waits.
  static constexpr std::chrono::seconds kPatience{3};

  static void hear(std::int64_t stamp_ns, Clock::time_point now, Topic* topic) {
    const bool begins_anew = now - topic->heard > kPatience;  // as after a pause
    if (!topic->alone_since || begins_anew) topic->alone_since = now;
    topic->stamp_ns = stamp_ns;
    topic->heard = now;
  }

  Topic frames_, detections_;
};

}  // namespace semantic_topo_loop
