#pragma once

#include <string>
#include <vector>

#include "semantic_topo_loop/frontend/object_detector.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::apps {

/// What a detector finds in every color image of a recording, in order of their stamps: of a TUM folder (those of
/// rgb.txt or, where that is missing, of associations.txt) or of a bag in the layout of the TUM RGB-D bags.
/// @return an error that names the file for an image that cannot be read
core::Result<std::vector<core::DetectionFrame>> detect_in_recording(const std::string& folder_or_bag,
                                                                    core::ObjectDetector* detector);

}  // namespace semantic_topo_loop::apps
