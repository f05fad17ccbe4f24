#pragma once

#include <memory>

#include "semantic_topo_loop/io/yaml_files.h"
#include "support/test_files.h"

namespace semantic_topo_loop::core {

inline Camera camera_fr2() { return checked(read_camera(STL_CONFIG_DIR "/camera/tum_fr2.yaml")); }

/// For images that are made in the test.
inline Camera small_camera() { return {50.0, 50.0, 15.5, 11.5, 32, 24, {}}; }

inline ClassTable coco() { return checked(read_class_table(STL_CONFIG_DIR "/classes_coco.yaml")); }

inline std::shared_ptr<const ClassTable> shared_coco() { return std::make_shared<const ClassTable>(coco()); }

}  // namespace semantic_topo_loop::core
