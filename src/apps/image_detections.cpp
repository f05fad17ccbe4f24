#include "apps/image_detections.h"

#include <filesystem>
#include <opencv2/core.hpp>

#include "ros/tum_bag.h"
#include "semantic_topo_loop/io/rgbd_recording.h"

namespace semantic_topo_loop::apps {

core::Result<std::vector<core::DetectionFrame>> detect_in_recording(const std::string& folder_or_bag,
                                                                    core::ObjectDetector* detector) {
  std::vector<core::DetectionFrame> frames;
  const auto detect = [&frames, detector](std::int64_t stamp_ns, const cv::Mat& color) -> core::Status {
    core::Result<std::vector<core::Detection>> detections = detector->detect(color);
    if (!detections) return detections.error();
    frames.push_back({stamp_ns, *std::move(detections)});
    return {};
  };
  std::error_code missing;
  if (!std::filesystem::is_directory(folder_or_bag, missing)) {
    const core::Status read = for_each_color_image(folder_or_bag, [&](std::int64_t stamp_ns, const cv::Mat& color) {
      return detector->is_due(stamp_ns) ? detect(stamp_ns, color) : core::Status();
    });
    if (!read) return read.error();
    return frames;
  }
  const auto images = core::list_color_images(folder_or_bag);
  if (!images) return images.error();
  for (const auto& [stamp_ns, path] : *images) {
    if (!detector->is_due(stamp_ns)) continue;
    const core::Result<cv::Mat> color = core::read_color_image(path);
    if (!color) return color.error();
    if (const core::Status detected = detect(stamp_ns, *color); !detected) {
      return core::Error{path + ": " + detected.message()};
    }
  }
  return frames;
}

}  // namespace semantic_topo_loop::apps
