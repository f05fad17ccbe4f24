#pragma once

#include <cstdint>
#include <vector>

#include "semantic_topo_loop/types/box.h"

namespace semantic_topo_loop::core {

/// One box of an object detector, in pixels of the raw (distorted) image.
struct Detection {
  int class_id = -1;
  double score = 0.0;  ///< [0, 1]
  Box box;
};

/// All boxes of one image; empty when the detector ran and saw nothing.
struct DetectionFrame {
  std::int64_t stamp_ns = 0;
  std::vector<Detection> detections;
};

}  // namespace semantic_topo_loop::core
