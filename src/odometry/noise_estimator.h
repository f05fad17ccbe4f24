#pragma once

#include "odometry/innovation_model.h"

namespace semantic_topo_loop::core {

/// What is expected before any loop is seen, and how far an estimate may go from it.
struct NoisePrior {
  OdometryNoise least;
  double factor_max = 1000.0;  ///< on the least noise
  double evidence = 1.5;       ///< log likelihood to offer for each e-fold above the least
};

/// `start` with the jumps it states, if they still explain the innovations, and others that do: the model's cost plus
/// the price of each jump falls with each. An edge at which the motion stood out (suspicion) costs less. Then the most
/// probable noise.
/// @param max_new_jumps looked for in this call   @param cost becomes that of the result
NoiseEstimate estimate_noise_and_jumps(InnovationModel* model, const NoisePrior& prior, const NoiseEstimate& start,
                                       int max_new_jumps, double* cost = nullptr);

/// Most probable noise given the innovations. Innovations that the loops' own uncertainty explains leave the odometry
/// at a small noise, so that loops then hardly move it.
NoiseEstimate estimate_noise(const InnovationModel& model, const NoisePrior& prior, const NoiseEstimate& start);

/// A factor on the least noise at which most loops are likely, robust against a minority of false ones: the weighted
/// median over the loops, and one voice for the least noise itself.
/// @param explaining_factors of each loop, see PathNoise   @param weights e.g. 1 / redundancy
double robust_noise_factor(const std::vector<double>& explaining_factors, const std::vector<double>& weights);

}  // namespace semantic_topo_loop::core
