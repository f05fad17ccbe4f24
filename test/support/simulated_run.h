#pragma once

#include <gtest/gtest.h>

#include <cstddef>
#include <memory>
#include <utility>
#include <vector>

#include "pipeline/map_state.h"
#include "semantic_topo_loop/pipeline/frame_builder.h"
#include "semantic_topo_loop/pipeline/object_slam.h"
#include "support/test_files.h"
#include "tools/simulation/sequence.h"

namespace semantic_topo_loop::core::testing {

/// The whole chain on a simulated sequence, image by image.
class ChainRun {
 public:
  /// @param T_new_odom where the odometry starts   @param earlier null, or the map that the run goes on with
  ChainRun(const SimulatedSequence& sequence, const std::shared_ptr<const ClassTable>& classes, SE3 T_new_odom = {},
           const std::shared_ptr<const MapState>& earlier = nullptr, std::size_t begin = 0, const Options& options = {})
      : sequence_(sequence),
        T_new_odom_(std::move(T_new_odom)),
        slam_(options, classes),
        builder_(options.keyframe, sequence.camera),
        done_(begin) {
    if (earlier == nullptr) return;
    slam_.restore(*earlier);
    builder_.count_from(earlier->graph.next_frame_id, earlier->graph.next_keyframe_id());
  }

  /// @return stamp of the image
  std::int64_t next() {
    const auto& [stamp_ns, T_world_camera] = sequence_.odometry[done_];
    std::vector<Detection> detections;
    for (const SimulatedDetection& d : sequence_.detections[done_]) detections.push_back(d.detection);
    take(slam_.process(checked(builder_.build({stamp_ns, T_new_odom_ * T_world_camera})), &detections));
    ++done_;
    return stamp_ns;
  }
  void end() { take(slam_.process(builder_.end(), nullptr)); }

  std::size_t done() const { return done_; }
  ObjectSlam& slam() { return slam_; }
  const FrameResult& last() const { return last_; }  ///< of the last image, or the end
  int corrections() const { return corrections_; }
  std::size_t merges() const { return merges_; }

 private:
  void take(FrameResult result) {
    corrections_ += result.correction.changed ? 1 : 0;
    merges_ += result.observation.merged.size() + result.completion.merged.size();
    last_ = std::move(result);
  }

  const SimulatedSequence& sequence_;
  const SE3 T_new_odom_;
  ObjectSlam slam_;
  FrameBuilder builder_;
  std::size_t done_;
  FrameResult last_;
  int corrections_ = 0;
  std::size_t merges_ = 0;
};

/// The map after images `begin` to `end` of a simulated sequence, see ChainRun.
inline std::shared_ptr<const MapState> map_of(const SimulatedSequence& sequence, std::size_t begin, std::size_t end,
                                              const std::shared_ptr<const ClassTable>& classes,
                                              const SE3& T_new_odom = {},
                                              const std::shared_ptr<const MapState>& earlier = nullptr) {
  ChainRun run(sequence, classes, T_new_odom, earlier, begin);
  while (run.done() < end) run.next();
  run.end();
  return run.slam().map();
}

}  // namespace semantic_topo_loop::core::testing
