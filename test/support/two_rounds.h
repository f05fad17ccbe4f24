#pragma once

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>
#include <vector>

#include "semantic_topo_loop/geometry/lie.h"
#include "semantic_topo_loop/geometry/quadric.h"
#include "semantic_topo_loop/types/class_table.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/loop_closure.h"

namespace semantic_topo_loop::core {

/// A camera that goes round a cup, away, and round the same cup again, while its odometry drifts sideways on the way,
/// so that the cup is mapped twice until loops tell that it is one.
class TwoRounds {
 public:
  /// What a frame brings: its associations, and the loops that end there.
  using Step = std::function<void(const Frame&, const AssociationFrame&, const std::vector<LoopClosure>&)>;

  explicit TwoRounds(Step take_step) : take_step_(std::move(take_step)) {}

  /// Round the cup, away and back, and round it again.
  void both_rounds() {
    round(0);
    for (int i = 0; i < kAway; ++i) {
      constexpr double kDrift_m = 0.01;
      T_odom_world_.t.y() += kDrift_m;
      step(away(std::min(i, kAway - 1 - i)), -1, {});
    }
    round(1);
  }
  /// Looks at nothing; the loops are handed over first.
  void idle(std::vector<LoopClosure> loops) {
    for (int i = 0; i < kIdle; ++i) {
      step(away(0), -1, loops);
      loops.clear();
    }
  }
  Frame end_frame() const {
    Frame frame;
    frame.frame_id = next_frame_;
    frame.stamp_ns = stamp_ns(next_frame_);
    frame.is_end = true;
    return frame;
  }

  /// From each keyframe of the second round to the same of the first.
  static std::vector<LoopClosure> loops() {
    std::vector<LoopClosure> loops;
    for (int i = 0; i < kRound; i += kFramesPerKeyframe) {
      LoopClosure loop;
      loop.match_frame = loop.match_begin = loop.match_end = i;
      loop.query_frame = loop.query_begin = loop.query_end = i + kRound + kAway;
      loop.match_keyframe_id = loop.match_frame / kFramesPerKeyframe;
      loop.query_keyframe_id = loop.query_frame / kFramesPerKeyframe;
      loop.accepted = true;
      loop.reason = LoopReason::kAccepted;
      loop.covariance = 1e-6 * Mat6::Identity();
      loops.push_back(loop);
    }
    return loops;
  }
  static Ellipsoid cup() { return {SE3(so3_exp(Vec3(0.0, 0.0, 0.4)), Vec3(0.05, -0.1, 0.02)), Vec3(0.05, 0.04, 0.08)}; }
  static constexpr int kCup = 41;  ///< class

 private:
  static constexpr int kRound = 60, kAway = 60, kIdle = 120, kFramesPerKeyframe = 5;

  static std::int64_t stamp_ns(std::int64_t frame) { return 1'000'000'000 + frame * 33'333'333; }
  static SE3 look(const Vec3& position, const Vec3& direction) {
    const Vec3 z = direction.normalized(), x = z.cross(Vec3::UnitZ()).normalized();
    Mat3 R;
    R << x, z.cross(x), z;
    return {R, position};
  }
  static SE3 away(int i) { return look(Vec3(1.5, 0.03 * i, 0.8), Vec3(1.0, 0.01, 0.0)); }

  void round(std::int64_t id) {
    for (int i = 0; i < kRound; ++i) {
      const double angle = kPi / 2.0 * i / (kRound - 1);
      const Vec3 position(1.5 * std::cos(angle), 1.5 * std::sin(angle), 0.8);
      step(look(position, -position), id, {});
    }
  }

  void step(const SE3& T_world_camera, std::int64_t seen, const std::vector<LoopClosure>& loops) {
    Frame frame;
    frame.frame_id = next_frame_++;
    frame.stamp_ns = stamp_ns(frame.frame_id);
    frame.is_keyframe = frame.frame_id % kFramesPerKeyframe == 0;
    frame.keyframe_id = frame.frame_id / kFramesPerKeyframe;
    frame.T_odom_camera = T_odom_world_ * T_world_camera;
    frame.camera = Camera{520.0, 520.0, 320.0, 240.0, 640, 480, {}};
    AssociationFrame associations;
    associations.frame_id = frame.frame_id;
    if (seen >= 0) {
      Association association;
      association.landmark_id = seen;
      association.class_id = association.landmark_class_id = kCup;
      association.box = *project_box(cup(), projection_matrix(frame.camera, T_world_camera));
      associations.associations.push_back(association);
    }
    take_step_(frame, associations, loops);
  }

  Step take_step_;
  SE3 T_odom_world_;
  std::int64_t next_frame_ = 0;
};

}  // namespace semantic_topo_loop::core
