#pragma once

#include <nav_msgs/Odometry.h>
#include <tf2/buffer_core.h>
#include <tf2_msgs/TFMessage.h>

#include <cstdint>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "semantic_topo_loop/pipeline/frame_builder.h"
#include "semantic_topo_loop/pipeline/pose_buffer.h"
#include "semantic_topo_loop/types/result.h"
#include "semantic_topo_loop/types/stamp.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop {

/// Where PoseFrontend gets the camera's pose at the stamp of an image from. Not thread-safe.
class PoseSource {
 public:
  enum class Status {
    kFound,
    kNotYet,  ///< a pose may still arrive
    kNever,   ///< no later pose can help
  };
  struct Answer {
    Status status = Status::kNotYet;
    core::PoseSample sample;  ///< if found; its stamp is the one asked for
    std::string problem;      ///< else why not
  };

  virtual ~PoseSource() = default;
  /// @param camera_frame tf frame of the camera's optical frame
  virtual Answer at(std::int64_t stamp_ns, const std::string& camera_frame) = 0;
  /// A frame was made of the pose at this stamp, where the motion to the next one begins.
  virtual void use(std::int64_t /*stamp_ns*/) {}
  /// A new session begins: the next pose has no predecessor.
  virtual void reset() {}
};

/// Poses of a trajectory file, at its own stamps only.
class FilePoses : public PoseSource {
 public:
  explicit FilePoses(core::StampedPoses trajectory) : trajectory_(std::move(trajectory)) {}
  Answer at(std::int64_t stamp_ns, const std::string& camera_frame) override;

 private:
  core::StampedPoses trajectory_;
};

/// The transforms of /tf and /tf_static, with the promise that tf2 does not make: the moving edge below the odometry
/// frame is never interpolated across more than `max_gap_s`. Leading slashes of frame ids are stripped. When time jumps
/// back for a frame that was asked for, or on which that hangs, what was said about all moving frames is forgotten.
class TfPoses : public PoseSource {
 public:
  TfPoses(std::string odom_frame, double max_gap_s);

  /// @return an error that names frames and value if a transform was left out (the others are taken)
  core::Status add(const tf2_msgs::TFMessage& message, bool is_static);
  /// T_odom_camera
  Answer at(std::int64_t stamp_ns, const std::string& camera_frame) override;
  void use(std::int64_t stamp_ns) override { last_stamp_ns_ = stamp_ns; }
  void reset() override { last_stamp_ns_.reset(); }
  /// T_target_source at a stamp as tf2 interpolates it, without the check of gaps: for the rigid part of a robot.
  std::optional<core::SE3> find(const std::string& target, const std::string& source, std::int64_t stamp_ns);
  /// Whether a frame hangs on another than the odometry's.
  bool is_mounted(const std::string& frame) const { return root(frame) != frame; }
  /// The frame that a frame hangs on in the end, below the odometry's; itself if it hangs on none.
  std::string root(const std::string& frame) const { return ancestors(frame).back(); }

 private:
  core::Status add(const geometry_msgs::TransformStamped& transform, bool is_static);
  /// Where a sample with this stamp goes; forgets everything first if it says that time jumped back.
  core::PoseBuffer& moving_samples(const std::string& child, std::int64_t stamp_ns);
  /// A frame and those it hangs on, up to the odometry's, which is not among them, or to the root.
  std::vector<std::string> ancestors(const std::string& frame) const;
  bool is_needed(const std::string& child) const;

  const std::string odom_frame_;
  const double max_gap_s_;
  tf2::BufferCore buffer_;
  std::map<std::string, core::PoseBuffer> moving_;  ///< T_parent_child by child frame
  std::set<std::string> asked_;                     ///< frames that somebody wanted to know about
  std::optional<std::int64_t> last_stamp_ns_;       ///< of the last pose used
};

/// Poses of nav_msgs/Odometry messages: the pose of `child_frame_id`, moved to the camera by tf. Where that is empty or
/// the message's own frame it is that of `base_frame`; if there is none, an empty one's is the camera's.
///
/// The covariance of the motion between two images comes from the twist's: its errors last for a tenth of a second, or
/// from one image to the next if that is longer. While the pose stays the same they are a hundredth. The pose's own
/// covariance says how far the odometry has drifted since its start, which is no statement about one step.
class OdometryPoses : public PoseSource {
 public:
  OdometryPoses(std::shared_ptr<TfPoses> transforms, double max_gap_s, std::string base_frame = {});

  /// @return an error that names field and value if the message is left out
  core::Status add(const nav_msgs::Odometry& message);
  Answer at(std::int64_t stamp_ns, const std::string& camera_frame) override;
  void use(std::int64_t stamp_ns) override { last_stamp_ns_ = stamp_ns; }
  void reset() override { last_stamp_ns_.reset(); }

 private:
  std::optional<core::Mat6> step_covariance(std::int64_t stamp_ns, const core::SE3& T_base_camera) const;

  std::shared_ptr<TfPoses> transforms_;
  core::PoseBuffer poses_;
  std::map<std::int64_t, std::optional<core::Mat6>> twist_covariances_;  ///< of each message, by stamp
  const std::string base_frame_;                                         ///< where the messages name none
  std::string moved_frame_;                                              ///< empty: the camera's
  std::optional<std::int64_t> last_stamp_ns_;                            ///< of the last pose used
};

}  // namespace semantic_topo_loop
