#pragma once

#include <map>
#include <vector>

#include "geometry/object_points.h"
#include "map/mapped_landmark.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"

namespace semantic_topo_loop::core {

struct ExpectedLandmark {
  std::int64_t id = -1;
  double size_px = 0.0;          ///< of its projected box
  bool is_seen_through = false;  ///< depth shows what lies behind it
};

/// The landmarks that a detector should box in this frame: fully in view, large enough, and hidden by nothing known:
/// not by a nearer landmark, not by the box of something that is no landmark (a person), and, where the frame has
/// points, not by points in front of it.
/// @param points of the frame; null without   @return in order of id
std::vector<ExpectedLandmark> expected_landmarks(const std::map<std::int64_t, MappedLandmark>& landmarks,
                                                 const Frame& frame, const FramePoints* points, const SE3& T_map_camera,
                                                 const AssociationFrame& associations);

}  // namespace semantic_topo_loop::core
