#pragma once

#include <cstddef>
#include <optional>
#include <string>

#include "semantic_topo_loop/frontend/rgbd_image.h"

namespace semantic_topo_loop::core {

/// What reading an image came to.
struct RgbdReading {
  std::optional<RgbdImage> image;
  std::string error;     ///< why there is none
  std::string left_out;  ///< the cause, if the recording does not count it as an image at all
};

/// A recording's colour images with their depth, in time order.
class RgbdReader {
 public:
  virtual ~RgbdReader() = default;
  /// @return nullopt at the end; with `fault` set if the recording ends there by one
  virtual std::optional<RgbdReading> next(std::string* fault) = 0;
  /// Images in the recording, as far as is known before it is read.
  virtual std::size_t total() const = 0;
};

}  // namespace semantic_topo_loop::core
