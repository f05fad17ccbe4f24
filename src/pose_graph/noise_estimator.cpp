#include "semantic_topo_loop/pose_graph/noise_estimator.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace semantic_topo_loop::core {
namespace {

/// Logarithms of the factors on (least translation noise, least rotation noise, the loops' sigmas).
using LogFactors = std::array<double, 3>;

constexpr double kLogSigmaLoop = 0.35;  // a loop's sigmas are trusted to about 40 %
constexpr double kMaxLogLoop = 1.0;

NoiseEstimate to_estimate(const LogFactors& x, const NoisePrior& prior) {
  return {{prior.least.translation_m * std::exp(x[0]), prior.least.rotation_rad * std::exp(x[1])}, std::exp(x[2])};
}

double penalty(const LogFactors& x, const NoisePrior& prior) {
  return prior.evidence * (x[0] + x[1]) + 0.5 * x[2] * x[2] / (kLogSigmaLoop * kLogSigmaLoop);
}

}  // namespace

NoiseEstimate estimate_noise(const InnovationModel& model, const NoisePrior& prior, const NoiseEstimate& start) {
  const double high = std::log(prior.factor_max);
  const LogFactors lows{0.0, 0.0, 0.0}, highs{high, high, kMaxLogLoop};
  const auto cost = [&](const LogFactors& x) {
    const NoiseEstimate estimate = to_estimate(x, prior);
    return model.cost(estimate.odometry, estimate.loop_factor) + penalty(x, prior);
  };
  LogFactors best{std::log(start.odometry.translation_m / prior.least.translation_m),
                  std::log(start.odometry.rotation_rad / prior.least.rotation_rad), std::log(start.loop_factor)};
  for (std::size_t i = 0; i < best.size(); ++i) best[i] = std::clamp(best[i], lows[i], highs[i]);
  double best_cost = cost(best);
  // Compass search: three smooth parameters, each evaluation one small Cholesky.
  constexpr double kFirstStep = 0.8, kLastStep = 0.08;
  for (double step = kFirstStep; step > kLastStep;) {
    bool moved = false;
    for (std::size_t i = 0; i < best.size(); ++i) {
      for (const double sign : {1.0, -1.0}) {
        LogFactors x = best;
        x[i] = std::clamp(x[i] + sign * step, lows[i], highs[i]);
        if (x[i] == best[i]) continue;
        const double value = cost(x);
        if (!(value < best_cost)) continue;
        best = x;
        best_cost = value;
        moved = true;
        break;
      }
    }
    if (!moved) step *= 0.5;
  }
  return to_estimate(best, prior);
}

double robust_noise_factor(const InnovationModel& model, const NoisePrior& prior,
                           const std::vector<double>& redundancies) {
  std::vector<std::pair<double, double>> factors{{1.0, 1.0}};  // factor, weight
  double total = 1.0;
  for (std::size_t k = 0; k < model.size(); ++k) {
    const double weight = 1.0 / redundancies[k];
    factors.emplace_back(std::min(model.explaining_factor(k, prior.least, prior.factor_max), prior.factor_max), weight);
    total += weight;
  }
  std::sort(factors.begin(), factors.end());
  double below = 0.0;
  for (const auto& [factor, weight] : factors) {
    below += weight;
    if (below >= 0.5 * total) return factor;
  }
  return factors.back().first;
}

}  // namespace semantic_topo_loop::core
