#pragma once

#include "tools/simulation/sequence.h"

namespace semantic_topo_loop::core {

/// Streams of the seed; one a component, so that the options of one leave the others as they are.
enum SeedStream : std::uint64_t {
  kScene = 1,
  kTrajectory,
  kDrift,
  kDetector,
  kOdometryFrame,
  kDynamics,
  kTextures,
  kImageNoise,
  kScaleDrift
};

inline std::uint64_t seed_of(const SimulationOptions& options, SeedStream stream) {
  return static_cast<std::uint64_t>(options.seed) * 16 + stream;
}

}  // namespace semantic_topo_loop::core
