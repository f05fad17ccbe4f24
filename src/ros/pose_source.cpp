#include "ros/pose_source.h"

#include "semantic_topo_loop/types/stamp.h"

namespace semantic_topo_loop {

PoseSource::Answer FilePoses::at(std::int64_t stamp_ns, const std::string& /*camera_frame*/) {
  Answer answer;
  const core::StampedPose* pose = core::find_stamp(trajectory_, stamp_ns, kStampToleranceNs);
  if (pose == nullptr) {
    answer.status = Status::kNever;
    answer.problem = "the trajectory file has no pose within 1 us of stamp " + core::format_stamp(stamp_ns);
    return answer;
  }
  answer.status = Status::kFound;
  answer.sample.stamp_ns = stamp_ns;
  answer.sample.T_odom_camera = pose->T_world_camera;
  return answer;
}

}  // namespace semantic_topo_loop
