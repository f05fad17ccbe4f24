#pragma once

#include "map/mapped_landmark.h"
#include "semantic_topo_loop/map/mapper_options.h"

namespace semantic_topo_loop::core {

/// rho in [0, 1]: 1 for an object well seen from all around, 0 for a guess.
///   rho = mean IoU (1 - e^(-baseline / 15 deg)) (1 - e^(-seen / 0.7 s)) / (1 + sigma / 5 cm),
/// with sigma the root mean variance of the centre.
double landmark_quality(const MappedLandmark& landmark);

/// Candidate, confirmed or retired, from what is known now; only what is movable can have gone.
LandmarkState life_cycle_state(const MappedLandmark& landmark, const QuadricMapperOptions& options, bool is_movable);

}  // namespace semantic_topo_loop::core
