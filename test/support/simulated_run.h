#pragma once

#include <gtest/gtest.h>

#include <cstddef>
#include <memory>
#include <vector>

#include "pipeline/map_state.h"
#include "semantic_topo_loop/pipeline/frame_builder.h"
#include "semantic_topo_loop/pipeline/object_slam.h"
#include "support/test_files.h"
#include "tools/simulation/sequence.h"

namespace semantic_topo_loop::core::testing {

/// The map after images `begin` to `end` of a simulated sequence.
/// @param T_new_odom where the odometry starts   @param earlier null, or the map that the run goes on with
inline std::shared_ptr<const MapState> map_of(const SimulatedSequence& sequence, std::size_t begin, std::size_t end,
                                              const std::shared_ptr<const ClassTable>& classes,
                                              const SE3& T_new_odom = {},
                                              const std::shared_ptr<const MapState>& earlier = nullptr) {
  const Options options;
  ObjectSlam slam(options, classes);
  FrameBuilder builder(options.keyframe, sequence.camera);
  if (earlier != nullptr) {
    slam.restore(*earlier, sequence.camera);
    builder.count_from(earlier->next_frame_id, earlier->next_keyframe_id());
  }
  for (std::size_t i = begin; i < end; ++i) {
    PoseSample sample;
    sample.stamp_ns = sequence.odometry[i].stamp_ns;
    sample.T_odom_camera = T_new_odom * sequence.odometry[i].T_world_camera;
    std::vector<Detection> detections;
    for (const SimulatedDetection& d : sequence.detections[i]) detections.push_back(d.detection);
    slam.process(checked(builder.build(sample)), &detections);
  }
  slam.process(builder.end(), nullptr);
  return slam.map();
}

}  // namespace semantic_topo_loop::core::testing
