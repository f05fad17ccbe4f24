#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "apps/sample_source.h"
#include "loop/submap/submap_builder.h"
#include "semantic_topo_loop/io/detection_reader.h"
#include "semantic_topo_loop/io/run_recorder.h"
#include "semantic_topo_loop/pipeline/options.h"

namespace semantic_topo_loop::apps {

/// What a run works on.
struct RunInputs {
  core::Options options;
  core::Camera camera;
  std::shared_ptr<const core::ClassTable> classes;
  std::unique_ptr<SampleSource> source;
  std::vector<core::DetectionFrame> detections;
  std::vector<core::LoopClosure> extra_loops;
  std::optional<std::vector<core::LocalMap>> earlier_map;
  std::string save_map, points;
};

/// Puts every image of the source through the chain; from the first one again if the source corrects its calibration.
/// @return nullopt with `error` set if the inputs have no frame in common or a file cannot be written
std::optional<core::RunRecorder> run_chain(const RunInputs& inputs, std::string* error);

}  // namespace semantic_topo_loop::apps
