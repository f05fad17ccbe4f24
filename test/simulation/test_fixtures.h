#pragma once

#include <gtest/gtest.h>

#include <map>
#include <string>

#include "semantic_topo_loop/io/camera_yaml.h"
#include "semantic_topo_loop/io/class_table_yaml.h"
#include "semantic_topo_loop/simulation/sequence.h"

namespace semantic_topo_loop::core::simulation_test {

inline Camera camera_fr2() {
  std::string error;
  const auto camera = read_camera(STL_CONFIG_DIR "/camera/tum_fr2.yaml", &error);
  EXPECT_TRUE(camera) << error;
  return camera.value_or(Camera());
}

inline ClassTable coco() {
  std::string error;
  const auto classes = read_class_table(STL_CONFIG_DIR "/classes_coco.yaml", &error);
  EXPECT_TRUE(classes) << error;
  return classes.value_or(ClassTable());
}

/// Options from texts, which must be valid.
inline SimulationOptions options_of(const std::map<std::string, std::string>& texts) {
  std::string error;
  const auto options = make_simulation_options(texts, &error);
  EXPECT_TRUE(options) << error;
  return options.value_or(SimulationOptions());
}

/// A detector without errors that sees every object.
inline DetectorOptions perfect_detector() {
  DetectorOptions options;
  options.miss_rate = options.small_box_px = options.mislabel_rate = options.false_rate = 0.0;
  options.jitter_px = options.jitter_ratio = options.persistence_s = 0.0;
  options.min_visible = options.min_inside = 0.0;
  return options;
}

}  // namespace semantic_topo_loop::core::simulation_test
