#include "semantic_topo_loop/pipeline/frame_builder.h"

#include <algorithm>

#include "odometry/held_poses.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {

FrameBuilder::FrameBuilder(const KeyframeOptions& options, const Camera& camera)
    : options_(options), camera_(camera), held_poses_(std::make_shared<HeldPoses>()) {}

bool FrameBuilder::is_held(const PoseSample& sample) {
  return held_poses_->is_held(sample.stamp_ns, sample.T_odom_camera);
}

Result<Frame> FrameBuilder::build(const PoseSample& sample) {
  if (!sample.T_odom_camera.is_finite()) {
    return Error{"pose at stamp " + std::to_string(sample.stamp_ns) + " ns is not finite"};
  }
  if (last_ && sample.stamp_ns <= last_->stamp_ns) {
    return Error{"stamp " + std::to_string(sample.stamp_ns) + " ns is not after " + std::to_string(last_->stamp_ns) +
                 " ns"};
  }
  Frame frame;
  frame.frame_id = last_ ? last_->frame_id + 1 : first_frame_id_;
  frame.stamp_ns = sample.stamp_ns;
  frame.T_odom_camera = sample.T_odom_camera;
  frame.covariance = sample.covariance;
  frame.source_loop = sample.source_loop;
  frame.points_camera = sample.points_camera;
  frame.features = sample.features;
  frame.camera = camera_;

  const HeldPoses::Motion motion = held_poses_->move(sample.stamp_ns, sample.T_odom_camera);
  frame.held_since_ns = motion.caught_up_since_ns;
  frame.is_break = sample.is_break;
  if (last_) {
    const auto since_s = [&sample](std::int64_t stamp_ns) {
      return 1e-9 * static_cast<double>(sample.stamp_ns - stamp_ns);
    };
    // Of a faster camera, or of images that came together, a hiccup would be beyond all speeds.
    constexpr double kLeast_s = 0.03;
    const double moved_s = std::max(kLeast_s, since_s(frame.held_since_ns.value_or(last_->stamp_ns)));
    const double distance_m = (sample.T_odom_camera.t - last_->T_odom_camera.t).norm();
    const double angle_deg = degrees(rotation_angle(sample.T_odom_camera.q, last_->T_odom_camera.q));
    const bool has_gap = since_s(last_->stamp_ns) > options_.break_gap_s && !motion.is_way && !sample.is_continuous;
    frame.is_break = frame.is_break || has_gap || distance_m > options_.break_speed_m_s * moved_s ||
                     angle_deg > options_.break_rate_deg_s * moved_s;
  }
  if (frame.is_break) held_poses_->begin_anew();
  frame.is_keyframe = !last_keyframe_ || frame.is_break;
  if (!frame.is_keyframe) {
    // A robot that is parked for a day shows nothing new; odometry from images moves by less while it stands.
    constexpr double kStill_m = 0.01, kStill_deg = 0.25;
    const double dt_s = 1e-9 * static_cast<double>(sample.stamp_ns - last_keyframe_->stamp_ns);
    const double distance_m = (sample.T_odom_camera.t - last_keyframe_->T_odom_camera.t).norm();
    const double angle_deg = degrees(rotation_angle(sample.T_odom_camera.q, last_keyframe_->T_odom_camera.q));
    const bool has_waited = dt_s >= options_.max_interval_s && (distance_m >= kStill_m || angle_deg >= kStill_deg);
    frame.is_keyframe =
        has_waited || distance_m >= options_.min_translation_m || angle_deg >= options_.min_rotation_deg;
  }
  frame.keyframe_id = last_keyframe_ ? last_keyframe_->keyframe_id + (frame.is_keyframe ? 1 : 0) : first_keyframe_id_;
  last_ = frame;
  if (frame.is_keyframe) last_keyframe_ = frame;
  return frame;
}

Frame FrameBuilder::end() const {
  Frame frame = last_.value_or(Frame());
  frame.frame_id = last_ ? last_->frame_id + 1 : first_frame_id_;
  frame.is_keyframe = false;
  frame.is_break = false;
  frame.is_end = true;
  frame.covariance.reset();
  frame.held_since_ns.reset();
  frame.source_loop.reset();
  frame.points_camera.reset();
  frame.features.reset();
  frame.keyframe_points.reset();
  return frame;
}

}  // namespace semantic_topo_loop::core
