#pragma once

#include <nav_msgs/Odometry.h>

#include <cstdint>
#include <map>
#include <memory>
#include <string>

#include "ros/pose_tf.h"
#include "semantic_topo_loop/pipeline/pose_buffer.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop {

/// Poses of nav_msgs/Odometry messages: the pose of `child_frame_id`, moved to the camera by tf.
///
/// The covariance of the motion between two images comes from the twist's: its standard deviations times the time
/// between the images. The pose's own covariance says how far the odometry has drifted since its start, which is no
/// statement about one step.
class OdometryPoses : public PoseSource {
 public:
  OdometryPoses(std::shared_ptr<TfPoses> transforms, double max_gap_s);

  /// @return an error that names field and value if the message is left out
  core::Status add(const nav_msgs::Odometry& message);
  Answer at(std::int64_t stamp_ns, const std::string& camera_frame) override;
  void reset() override { last_stamp_ns_.reset(); }

 private:
  std::optional<core::Mat6> step_covariance(std::int64_t stamp_ns, const core::SE3& T_base_camera) const;

  std::shared_ptr<TfPoses> transforms_;
  core::PoseBuffer poses_;
  std::map<std::int64_t, core::Mat6> twist_covariances_;  ///< of the messages that state one, by stamp
  std::string base_frame_;                                ///< child_frame_id
  std::optional<std::int64_t> last_stamp_ns_;             ///< of the last pose given out
};

}  // namespace semantic_topo_loop
