#include "apps/image_detections.h"

#include <filesystem>
#include <opencv2/core.hpp>

#include "ros/tum_bag.h"
#include "semantic_topo_loop/io/detection_file.h"
#include "semantic_topo_loop/io/rgbd_recording.h"

namespace semantic_topo_loop::apps {

core::Result<ImageDetections> detect_in_recording(const std::string& folder_or_bag, core::ObjectDetector* detector) {
  ImageDetections found;
  core::DetectionReport::Cause unreadable;
  const auto detect = [&](std::int64_t stamp_ns, const core::Result<cv::Mat>& color) -> core::Status {
    if (!color) {
      if (unreadable.count++ == 0) unreadable.first = color.message();
      return {};
    }
    core::Result<std::vector<core::Detection>> detections = detector->detect(*color);
    if (!detections) return detections.error();
    found.frames.push_back({stamp_ns, *std::move(detections)});
    return {};
  };
  const auto finish = [&]() -> core::Result<ImageDetections> {
    if (unreadable.count == 0) return std::move(found);
    if (found.frames.empty()) return core::Error{"no image can be read (first: " + unreadable.first + ")"};
    found.warning = std::to_string(unreadable.count) + " images left out (first: " + unreadable.first + ")";
    return std::move(found);
  };
  std::error_code missing;
  if (!std::filesystem::is_directory(folder_or_bag, missing)) {
    const auto take = [&](std::int64_t stamp_ns, const core::Result<cv::Mat>& color) {
      return detector->is_due(stamp_ns) ? detect(stamp_ns, color) : core::Status();
    };
    if (const core::Status read = for_each_color_image(folder_or_bag, take); !read) return read.error();
    return finish();
  }
  const auto images = core::list_color_images(folder_or_bag);
  if (!images) return images.error();
  for (const auto& [stamp_ns, path] : *images) {
    if (!detector->is_due(stamp_ns)) continue;
    if (const core::Status detected = detect(stamp_ns, core::read_color_image(path)); !detected) {
      return core::Error{path + ": " + detected.message()};
    }
  }
  return finish();
}

}  // namespace semantic_topo_loop::apps
