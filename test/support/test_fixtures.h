#pragma once

#include <gtest/gtest.h>

#include <map>
#include <string>
#include <utility>

#include "support/package_config.h"
#include "tools/simulation/sequence.h"

namespace semantic_topo_loop::core::simulation_test {

/// Options from texts, which must be valid.
inline SimulationOptions options_of(const std::map<std::string, std::string>& texts) {
  return checked(make_options<SimulationOptions>(texts));
}

/// Simulated from texts, which must be valid.
inline SimulatedSequence simulate_fr2(const std::map<std::string, std::string>& texts,
                                      const ClassTable& classes = coco()) {
  return checked(simulate(options_of(texts), camera_fr2(), classes));
}

/// A camera in a z-up world that looks along +x.
inline SE3 looking_along_x(const Vec3& position) {
  Mat3 R;
  R << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  return {R, position};
}

/// An object that is turned about its vertical axis.
inline SceneObject turned_object(int class_id, const Vec3& center, const Vec3& semi_axes) {
  SceneObject object;
  object.class_id = class_id;
  object.ellipsoid.T_world_quadric = SE3(Quaternion(Eigen::AngleAxisd(0.7, Vec3::UnitZ())), center);
  object.ellipsoid.semi_axes = semi_axes;
  return object;
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
