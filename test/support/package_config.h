#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <string>

#include "semantic_topo_loop/io/camera_yaml.h"
#include "semantic_topo_loop/io/class_table_yaml.h"

namespace semantic_topo_loop::core {

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

inline std::shared_ptr<const ClassTable> shared_coco() { return std::make_shared<const ClassTable>(coco()); }

}  // namespace semantic_topo_loop::core
