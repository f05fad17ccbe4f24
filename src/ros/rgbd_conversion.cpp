#include "ros/rgbd_conversion.h"

#include <cv_bridge/cv_bridge.h>
#include <sensor_msgs/image_encodings.h>

#include <exception>

#include "ros/conversions.h"

namespace semantic_topo_loop {
namespace {

namespace encodings = sensor_msgs::image_encodings;

/// A copy of the pixels, for the front end may keep the image longer than the message lives.
std::optional<cv::Mat> to_mat(const sensor_msgs::Image& image, const std::string& encoding, const char* what,
                              std::string* error) {
  try {
    return cv_bridge::toCvCopy(image, encoding)->image;
  } catch (const std::exception& exception) {
    // cv_bridge's own exceptions, and OpenCV's for sizes that a pattern cannot have.
    if (error != nullptr) {
      *error = std::string(what) + " image, " + std::to_string(image.width) + " x " + std::to_string(image.height) +
               ", encoding '" + image.encoding + "': " + exception.what();
    }
    return std::nullopt;
  }
}

}  // namespace

std::optional<core::RgbdImage> make_rgbd_image(const sensor_msgs::Image& color, const sensor_msgs::Image& depth,
                                               const core::Camera& camera, const core::DepthOptions& options,
                                               std::string* error) {
  const std::optional<cv::Mat> gray = to_mat(color, encodings::MONO8, "colour", error);
  if (!gray) return std::nullopt;
  if (depth.encoding != encodings::TYPE_32FC1 && depth.encoding != encodings::TYPE_16UC1 &&
      depth.encoding != encodings::MONO16) {
    if (error != nullptr) *error = "depth image of encoding '" + depth.encoding + "', which must be 32FC1 or 16UC1";
    return std::nullopt;
  }
  const std::optional<cv::Mat> distance = to_mat(depth, depth.encoding, "depth", error);
  if (!distance) return std::nullopt;
  core::Result<core::RgbdImage> image =
      core::make_rgbd_image(to_stamp_ns(color.header.stamp), *gray, *distance, camera, options);
  if (image) return *std::move(image);
  if (error != nullptr) *error = image.message();
  return std::nullopt;
}

}  // namespace semantic_topo_loop
