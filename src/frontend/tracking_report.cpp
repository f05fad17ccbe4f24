#include "semantic_topo_loop/frontend/tracking_report.h"

#include <utility>

namespace semantic_topo_loop::core {

void TrackingReport::add(const TrackedImage& image) {
  ++images;
  switch (image.state) {
    case TrackingState::kStarted:
      if (image.sample && image.sample->is_break) ++restarts;
      break;
    case TrackingState::kTracked:
      ++tracked;
      break;
    case TrackingState::kRelocalised:
      ++relocalised;
      break;
    case TrackingState::kLost:
      ++lost;
      break;
    case TrackingState::kUnusable:
      ++unusable;
      break;
  }
}

void TrackingReport::add_unreadable(const std::string& problem) {
  ++images;
  if (++unreadable == 1) first_unreadable = problem;
}

std::string TrackingReport::warning() const {
  if (lost + unusable + unreadable + restarts == 0) return "";
  std::string text = "of " + std::to_string(images) + " images:";
  const char* separator = " ";
  for (const auto& [count, what] :
       {std::pair(lost, "lost"), std::pair(unusable, "with nothing to follow"), std::pair(unreadable, "unreadable"),
        std::pair(relocalised, "found again after a loss"), std::pair(restarts, "starts anew")}) {
    if (count == 0) continue;
    text += separator + std::to_string(count) + " " + what;
    separator = ", ";
  }
  if (unreadable > 0) text += " (first unreadable: " + first_unreadable + ")";
  return text;
}

}  // namespace semantic_topo_loop::core
