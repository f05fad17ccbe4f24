#include "ros/detection_watch.h"

#include "semantic_topo_loop/types/stamp.h"
#include "semantic_topo_loop/types/text.h"

namespace semantic_topo_loop {

std::string DetectionWatch::starvation(Clock::time_point now) const {
  const auto is_heard = [now](const Topic& topic) { return topic.stamp_ns && now - topic.heard < kPatience; };
  const auto is_alone = [now, is_heard](const Topic& topic) {
    return is_heard(topic) && topic.alone_since && now - *topic.alone_since > kPatience;
  };
  if (!is_alone(frames_) && !is_alone(detections_)) return {};
  const auto quoted = [](const Topic& topic) { return "'" + topic.name + "'"; };
  std::string text;
  if (is_heard(frames_) && is_heard(detections_)) {
    text = "frames on " + quoted(frames_) + " and detections on " + quoted(detections_) +
           ", but none with the stamp of the other";
  } else if (is_heard(frames_)) {
    text = "frames on " + quoted(frames_) + ", but no detections on " + quoted(detections_);
  } else {
    text = "detections on " + quoted(detections_) + ", but no frames on " + quoted(frames_);
  }
  for (const Topic* topic : {&frames_, &detections_}) {
    text += "; " + quoted(*topic) +
            (topic->stamp_ns ? ": last stamp " + core::format_stamp(*topic->stamp_ns) : ": nothing yet");
  }
  if (!frames_.stamp_ns || !detections_.stamp_ns) return text;
  constexpr int kDecimals = 6;
  const double gap_s = 1e-9 * static_cast<double>(*detections_.stamp_ns - *frames_.stamp_ns);
  return text + "; gap " + core::format_fixed(gap_s, kDecimals) + " s";
}

}  // namespace semantic_topo_loop
