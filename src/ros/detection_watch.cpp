#include "ros/detection_watch.h"

#include "semantic_topo_loop/types/stamp.h"
#include "semantic_topo_loop/types/text.h"

namespace semantic_topo_loop {

std::string DetectionWatch::starvation(Clock::time_point now) const {
  const auto is_alone = [now](const Topic& topic) {
    return topic.alone_since && now - *topic.alone_since > kPatience && now - topic.heard < kPatience;
  };
  const bool frames_alone = is_alone(frames_), detections_alone = is_alone(detections_);
  if (!frames_alone && !detections_alone) return {};
  const auto quoted = [](const Topic& topic) { return "'" + topic.name + "'"; };
  std::string text;
  if (frames_alone && detections_alone) {
    text = "frames on " + quoted(frames_) + " and detections on " + quoted(detections_) +
           ", but none with the stamp of the other";
  } else if (frames_alone) {
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
