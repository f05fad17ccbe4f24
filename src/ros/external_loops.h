#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "semantic_topo_loop/ExternalLoop.h"
#include "semantic_topo_loop/pipeline/pose_buffer.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/loop_closure.h"

namespace semantic_topo_loop {

/// Loops from outside, between any two images of a session; the odometry takes them to keyframes. Each frame's pose is
/// kept, since a loop may lead to any of them: 128 bytes, 14 MB an hour at 30 Hz.
class ExternalLoops {
 public:
  /// Is told why a loop can never be used.
  using Refuse = std::function<void(const std::string&)>;

  explicit ExternalLoops(Refuse refuse) : refuse_(std::move(refuse)) {}

  /// Every frame, in order of time.
  void add(const core::Frame& frame);
  void add(const ExternalLoop::ConstPtr& loop) { waiting_.push_back(loop); }
  /// Those whose images are not newer than the last frame, as accepted loops.
  std::vector<core::LoopClosure> take();
  /// The session is over: refuses what still waits, and forgets the frames.
  void end();

 private:
  struct KeyframeIds {
    std::int64_t keyframe_id = -1, frame_id = -1;
  };
  /// Frames without a break of the odometry among them, by stamp.
  struct Section {
    Section();

    core::PoseBuffer odometry;
    std::map<std::int64_t, KeyframeIds> keyframes;
  };
  /// Of an image.
  struct Place {
    core::PoseBuffer::Status status = core::PoseBuffer::Status::kNotYet;  ///< kGap: in a break of the odometry
    KeyframeIds ids;                                                      ///< of the last keyframe that is not newer
    std::int64_t stamp_ns = 0;                                            ///< of that
    core::SE3 T_keyframe_camera;
  };

  Place place(std::int64_t stamp_ns) const;
  void refuse_waiting(const std::string& why);
  static core::Result<core::LoopClosure> closure(const Place& query, const Place& match,
                                                 const geometry_msgs::PoseWithCovariance& match_from_query);

  const Refuse refuse_;
  std::map<std::int64_t, Section> sections_;  ///< by their first stamps
  std::vector<ExternalLoop::ConstPtr> waiting_;
};

}  // namespace semantic_topo_loop
