#pragma once

#include <cstdint>
#include <vector>

#include "semantic_topo_loop/loop/loop_options.h"
#include "semantic_topo_loop/types/box.h"
#include "semantic_topo_loop/types/local_map.h"

namespace semantic_topo_loop::core {

/// A box of a submap as a ray with an extent.
struct BoxRay {
  int frame = -1;  ///< index in LocalMap::frames
  std::int64_t landmark_id = -1;
  std::int64_t track_id = -1;
  int class_id = -1;
  Box box;                         ///< on the plane z = 1
  std::uint8_t truncated = 0;      ///< Truncation bits
  Vec3 direction = Vec3::UnitZ();  ///< unit, local frame
  double depth_m = 0.0;            ///< of the object's centre; 0 where the frame does not tell
  Vec3 point = Vec3::Zero();       ///< where the depth puts that centre, local frame

  bool is_whole() const { return truncated == 0; }
  bool is_placed() const { return depth_m > 0.0; }
  /// Of a box that is cut, depth tells where at least what it shows is.
  bool tells_place() const { return is_whole() || is_placed(); }
};

struct RayCluster {
  Vec3 center = Vec3::Zero();  ///< local frame, m
  std::vector<int> rays;       ///< at most one a frame, ascending
  double parallax_rad = 0.0;   ///< largest angle between two of its whole boxes' rays
  int placed = 0;              ///< rays whose depth is known
};

/// Nearer, an object fills the view, m.
constexpr double kMinVisibleDepth_m = 0.3;

/// Finds the points at which the boxes of one label meet. Tracks propose points; the boxes decide: a track that
/// holds two objects is split, and boxes of one object on several tracks are gathered.
/// @param rays of one label, by frame   @param frames of the submap
/// @return those of at least `LoopOptions::min_views` frames that are known to a depth, the best supported first
std::vector<RayCluster> cluster_rays(const std::vector<BoxRay>& rays, const std::vector<LocalFrame>& frames,
                                     const LoopOptions& options);

}  // namespace semantic_topo_loop::core
