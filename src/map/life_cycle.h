#pragma once

#include <map>
#include <vector>

#include "geometry/depth_points.h"
#include "map/mapped_landmark.h"
#include "semantic_topo_loop/map/mapper_options.h"
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

/// rho in [0, 1]: 1 for an object well seen from all around, 0 for a guess.
///   rho = mean IoU (1 - e^(-baseline / 15 deg)) (1 - e^(-seen / 0.7 s)) / (1 + sigma / 5 cm),
/// with sigma the root mean variance of the centre.
double landmark_quality(const MappedLandmark& landmark);

/// Candidate, confirmed or retired, from what is known now; only what is movable can have gone.
LandmarkState life_cycle_state(const MappedLandmark& landmark, const QuadricMapperOptions& options, bool is_movable);

}  // namespace semantic_topo_loop::core
