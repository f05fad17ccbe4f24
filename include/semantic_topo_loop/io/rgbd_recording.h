#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "semantic_topo_loop/frontend/rgbd_image.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// What reading an image came to.
struct RgbdReading {
  Result<RgbdImage> image;
  std::string left_out;  ///< the cause, if the recording does not count it as an image at all
  /// CV_8UC3 as BGR, for a detector, which seldom looks at every image: decoded when it is asked for.
  std::function<Result<cv::Mat>()> color;
};

/// A recording's color images with their depth, in time order.
struct RgbdRecording {
  /// @return nullopt at the end, an error if the recording ends there by a fault
  std::function<Result<std::optional<RgbdReading>>()> next;
  std::size_t total = 0;  ///< images in it, as far as is known before it is read
};

/// A color image and the depth image that belongs to it.
struct RgbdFile {
  std::int64_t stamp_ns = 0;  ///< of the color image
  std::string color, depth;   ///< paths
};

/// Files in order of their stamps.
struct RgbdFiles {
  std::vector<RgbdFile> files;
  std::string warning;  ///< what was left out; empty if nothing
};

/// Reads the list of a TUM folder: `t_rgb rgb_path t_depth depth_path` a line (more columns are left alone), `#`
/// comments; paths are relative to `directory`. Rows whose stamp is not after that of the row before are left out.
/// @return an error, with file, line and value, for a missing or empty file or a line that is none
Result<RgbdFiles> read_associations(const std::string& path, const std::string& directory);

/// Joins rgb.txt and depth.txt of a TUM folder as it is downloaded (`stamp path` a line, `#` comments) as the
/// benchmark's associate.py does: pairs less than 0.02 s apart, the nearest first, each image in one pair at most. The
/// warning tells how many.
/// @return an error, with file, line and value, for a missing or empty file or a line that is none, or no pair
Result<RgbdFiles> associate_images(const std::string& directory);

/// The images of a TUM folder: by the list `associations`; if that is empty, by the folder's associations.txt, or by
/// its rgb.txt and depth.txt where there is none.
/// @return an error as of read_associations or associate_images
Result<RgbdFiles> list_rgbd_images(const std::string& directory, const std::string& associations);

/// Path of each color image of a TUM folder by its stamp, ns: those of rgb.txt or, where that is missing, of
/// associations.txt.
/// @return an error, with file, line and value, for a missing or empty file or a line that is none
Result<std::map<std::int64_t, std::string>> list_color_images(const std::string& directory);

/// @return CV_8UC3 as BGR; an error, with path and cause, if the file is missing or no image
Result<cv::Mat> read_color_image(const std::string& path);

/// @return an error, with path and cause, if a file is missing, no image, or not what the camera makes
Result<RgbdImage> read_rgbd_image(const RgbdFile& file, const Camera& camera, const DepthOptions& options);

/// The images of a list, read one after the other.
RgbdRecording read_images(std::vector<RgbdFile> files, const Camera& camera, const DepthOptions& options);

}  // namespace semantic_topo_loop::core
