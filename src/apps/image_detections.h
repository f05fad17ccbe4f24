#pragma once

#include <string>
#include <vector>

#include "semantic_topo_loop/frontend/object_detector.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::apps {

struct ImageDetections {
  std::vector<core::DetectionFrame> frames;  ///< in order of their stamps
  std::string warning;                       ///< images that could not be read; empty if none
};

/// What a detector finds in every color image of a recording: of a TUM folder (those of rgb.txt or, where that is
/// missing, of associations.txt) or of a bag in the layout of the TUM RGB-D bags.
/// @return an error, with file and cause, if the recording or none of its images can be read, or the model fails
core::Result<ImageDetections> detect_in_recording(const std::string& folder_or_bag, core::ObjectDetector* detector);

}  // namespace semantic_topo_loop::apps
