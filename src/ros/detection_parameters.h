#pragma once

#include <string>

#include "ros/stage.h"

namespace semantic_topo_loop {

/// Where DetectionIngestion finds detections.
struct DetectionParameters : ClassStageParameters {
  std::string source = "topic";
  std::string detections_file;
  double detection_timeout_s = 0.5;

  template <class Visitor>
  void visit(Visitor& visitor) {
    ClassStageParameters::visit(visitor);
    visitor("source", source, "where detections come from: topic (detections_in), file, or none");
    visitor("detections_file", detections_file, "file: OA-SLAM JSON, or a directory of YOLO text files");
    visitor("detection_timeout_s", detection_timeout_s, "topic: how long a frame waits for its detections, wall time");
  }
  bool is_valid(std::string* error) const;
};

}  // namespace semantic_topo_loop
