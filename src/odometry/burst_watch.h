#pragma once

#include <cstddef>

#include "odometry/motion_bursts.h"
#include "semantic_topo_loop/types/frame.h"

namespace semantic_topo_loop::core {

/// Tells jumps of the odometry by its motion alone, some ten frames later.
class BurstWatch {
 public:
  /// @return true if a jump that spoils a submap has just been noticed
  bool push(const Frame& frame);

 private:
  MotionBursts bursts_;
  std::size_t section_ = 0;
  int frames_ = 0;  ///< in the section
};

}  // namespace semantic_topo_loop::core
