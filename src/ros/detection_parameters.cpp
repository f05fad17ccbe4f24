#include "ros/detection_parameters.h"

#include <sstream>

namespace semantic_topo_loop {

bool DetectionParameters::is_valid(std::string* error) const {
  if (!ClassStageParameters::is_valid(error)) return false;
  std::ostringstream problem;
  if (source != "topic" && source != "file" && source != "none") {
    problem << "parameter 'source' = '" << source << "' must be topic, file or none";
  } else if (source == "file" && detections_file.empty()) {
    problem << "parameter 'detections_file' = '' must be given with source file";
  } else if (!(detection_timeout_s >= 0.0)) {
    problem << "parameter 'detection_timeout_s' = " << detection_timeout_s << " must be >= 0";
  }
  if (problem.str().empty()) return true;
  if (error != nullptr) *error = problem.str();
  return false;
}

}  // namespace semantic_topo_loop
