#include "odometry/burst_watch.h"

namespace semantic_topo_loop::core {
namespace {

constexpr int kFramesPerSection = 15;
constexpr double kMinTranslation = 0.05;  ///< m; less does not spoil a submap
constexpr double kMinRotation = 0.06;     ///< rad; as much at about a metre

}  // namespace

bool BurstWatch::push(const Frame& frame) {
  bursts_.push({frame.stamp_ns, frame.T_odom_camera}, frame.is_break, section_);
  // A burst may lie across the border of two sections.
  Vec6 suspect = bursts_.suspect(section_).motion;
  if (section_ > 0) suspect += bursts_.suspect(section_ - 1).motion;
  const bool jumped = suspect.head<3>().norm() > kMinTranslation || suspect.tail<3>().norm() > kMinRotation;
  constexpr std::size_t kBeyond = 2;  // what is still to come of this burst belongs to the old sections
  if (jumped || ++frames_ == kFramesPerSection) {
    section_ += jumped ? kBeyond : 1;
    frames_ = 0;
  }
  return jumped;
}

}  // namespace semantic_topo_loop::core
