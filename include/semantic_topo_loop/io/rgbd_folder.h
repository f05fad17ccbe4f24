#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "semantic_topo_loop/io/rgbd_reader.h"

namespace semantic_topo_loop::core {

/// A colour image and the depth image that belongs to it.
struct RgbdFile {
  std::int64_t stamp_ns = 0;  ///< of the colour image
  std::string color, depth;   ///< paths
};

/// Reads the list of a TUM folder: `t_rgb rgb_path t_depth depth_path` a line (more columns are left alone), `#`
/// comments; paths are relative to `directory`. Rows whose stamp is not after that of the row before are left out.
/// @param warning what was left out; empty if nothing
/// @return nullopt, with file, line and value in `error`, for a missing or empty file or a line that is none
std::optional<std::vector<RgbdFile>> read_associations(const std::string& path, const std::string& directory,
                                                       std::string* warning, std::string* error);

/// @return nullopt, with path and cause in `error`, if a file is missing, no image, or not what the camera makes
std::optional<RgbdImage> read_rgbd_image(const RgbdFile& file, const Camera& camera, const DepthOptions& options,
                                         std::string* error);

/// The images of a list, read one after the other.
class RgbdFolder : public RgbdReader {
 public:
  RgbdFolder(std::vector<RgbdFile> files, const Camera& camera, const DepthOptions& options)
      : files_(std::move(files)), camera_(camera), options_(options) {}
  std::optional<RgbdReading> next(std::string* fault) override;
  std::size_t total() const override { return files_.size(); }

 private:
  std::vector<RgbdFile> files_;
  Camera camera_;
  DepthOptions options_;
  std::size_t index_ = 0;
};

}  // namespace semantic_topo_loop::core
