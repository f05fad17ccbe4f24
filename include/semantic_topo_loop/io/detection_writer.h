#pragma once

#include <string>
#include <vector>

#include "semantic_topo_loop/types/detection.h"

namespace semantic_topo_loop::core {

/// Write what read_detections reads; stamps become file names.
/// @return false, with the path in `error`, if a file cannot be written
bool write_detections_json(const std::string& path, const std::vector<DetectionFrame>& frames, std::string* error);
bool write_detections_yolo(const std::string& directory, const std::vector<DetectionFrame>& frames, std::string* error);

}  // namespace semantic_topo_loop::core
