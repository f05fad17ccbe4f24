#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/option_visitor.h"
#include "semantic_topo_loop/types/result.h"

namespace semantic_topo_loop::core {

/// When a frame becomes a keyframe, and when the odometry is taken to have jumped.
struct KeyframeOptions {
  double min_translation_m = 0.10;
  double min_rotation_deg = 7.0;
  double max_interval_s = 1.0;
  double break_speed_m_s = 6.0;
  double break_rate_deg_s = 600.0;
  double break_gap_s = 1.0;

  void visit(OptionVisitor& visitor) {
    visitor.module("keyframe");
    visitor("min_translation_m", min_translation_m, positive(), "a keyframe after this motion since the last one");
    visitor("min_rotation_deg", min_rotation_deg, positive(), "a keyframe after this rotation since the last one");
    visitor("max_interval_s", max_interval_s, positive(),
            "a keyframe after this time at the latest, unless the camera stands still");
    visitor("break_speed_m_s", break_speed_m_s, positive(),
            "faster motion between two frames is a break of the odometry");
    visitor("break_rate_deg_s", break_rate_deg_s, positive(), "faster rotation between two frames is a break");
    visitor("break_gap_s", break_gap_s, positive(),
            "a longer time between two frames is a break, unless RgbdFrontend found its map again, tf or odometry had "
            "no gap, or it is below 2 s and the odometry moved, up to three times as fast as before");
  }
};

class HeldPoses;

/// Turns camera poses into frames: numbers them, selects keyframes, flags breaks.
class FrameBuilder {
 public:
  FrameBuilder(const KeyframeOptions& options, const Camera& camera);

  /// Call it once an image, before `build`.
  /// @return true if the image is best left out: the odometry is slower than the images, and this is its last pose
  /// again
  bool is_held(const PoseSample& sample);
  /// @return an error, with the field and value, for a non-finite pose or a stamp not after the last one
  Result<Frame> build(const PoseSample& sample);
  /// The frame without an image that ends a stream.
  Frame end() const;
  void set_camera(const Camera& camera) { camera_ = camera; }
  /// Counts on from an earlier session. Call it before the first frame.
  void count_from(std::int64_t frame_id, std::int64_t keyframe_id) {
    first_frame_id_ = frame_id;
    first_keyframe_id_ = keyframe_id;
  }

 private:
  KeyframeOptions options_;
  Camera camera_;
  std::int64_t first_frame_id_ = 0, first_keyframe_id_ = 0;
  std::optional<Frame> last_;
  std::optional<Frame> last_keyframe_;
  std::shared_ptr<HeldPoses> held_poses_;
};

}  // namespace semantic_topo_loop::core
