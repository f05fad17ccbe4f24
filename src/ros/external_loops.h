#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "semantic_topo_loop/ExternalLoop.h"
#include "semantic_topo_loop/pipeline/pose_buffer.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/loop_closure.h"

namespace semantic_topo_loop {

/// Loops from outside, between any two images of a session; the odometry takes them to keyframes.
class ExternalLoops {
 public:
  ExternalLoops();

  void add(const core::Frame& keyframe);
  void add(const ExternalLoop::ConstPtr& loop) { waiting_.push_back(loop); }
  /// Those whose images are not newer than the last keyframe, as accepted loops.
  /// @param refuse is told why one can never be used
  std::vector<core::LoopClosure> take(const std::function<void(const std::string&)>& refuse);

 private:
  struct KeyframeIds {
    std::int64_t keyframe_id = -1, frame_id = -1;
  };
  /// Of an image.
  struct Place {
    core::PoseBuffer::Status status = core::PoseBuffer::Status::kNotYet;
    KeyframeIds ids;            ///< of the last keyframe that is not newer
    std::int64_t stamp_ns = 0;  ///< of that
    core::SE3 T_keyframe_camera;
  };

  Place place(std::int64_t stamp_ns) const;
  static core::Result<core::LoopClosure> closure(const Place& query, const Place& match,
                                                 const geometry_msgs::PoseWithCovariance& match_from_query);

  core::PoseBuffer odometry_;                      ///< of the keyframes
  std::map<std::int64_t, KeyframeIds> keyframes_;  ///< by stamp
  std::vector<ExternalLoop::ConstPtr> waiting_;
};

}  // namespace semantic_topo_loop
