#pragma once

#include <cstdint>
#include <vector>

#include "loop/graph/local_map.h"

namespace semantic_topo_loop::core {

/// A box of a submap as a ray with an extent.
struct BoxRay {
  int frame = -1;  ///< index in LocalMap::frames
  std::int64_t landmark_id = -1;
  std::int64_t track_id = -1;
  int class_id = -1;
  Box box;                         ///< on the plane z = 1
  bool full = false;               ///< no side is cut
  Vec3 direction = Vec3::UnitZ();  ///< unit, local frame
};

struct RayCluster {
  Vec3 center = Vec3::Zero();  ///< local frame, m
  std::vector<int> rays;       ///< at most one a frame, ascending
  double parallax_rad = 0.0;   ///< largest angle between two of its full rays
};

struct RayClusterOptions {
  int min_views = 6;
  double min_parallax_rad = 0.09;
  double max_depth_m = 6.0;
};

/// Finds the points at which the boxes of one label meet. Tracks propose points; the boxes decide: a track that
/// holds two objects is split, and boxes of one object on several tracks are gathered.
std::vector<RayCluster> cluster_rays(const std::vector<BoxRay>& rays, const std::vector<LocalFrame>& frames,
                                     const RayClusterOptions& options);

}  // namespace semantic_topo_loop::core
