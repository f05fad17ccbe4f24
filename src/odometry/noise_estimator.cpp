#include "odometry/noise_estimator.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace semantic_topo_loop::core {
namespace {

/// Logarithms of the factors on the least noise (translation and rotation walk, steady translation and rotation, scale,
/// suspicion) and on the loops' sigmas.
constexpr std::size_t kSuspicionIndex = 5, kLoopIndex = 6;
using LogFactors = std::array<double, kLoopIndex + 1>;

constexpr std::size_t kWalks = 2;
constexpr double kSteadyShare =
    0.3;  // of the evidence asked for: every odometry drifts, and the least is next to nothing
constexpr double kLogSigmaLoop = 0.35;  // a loop's sigmas are trusted to about 40 %
constexpr double kMaxLogLoop = 1.0;

std::array<double, kLoopIndex> values(const OdometryNoise& noise) {
  return {noise.translation_m,       noise.rotation_rad, noise.steady_translation,
          noise.steady_rotation_rad, noise.scale,        noise.suspicion};
}

NoiseEstimate to_estimate(const LogFactors& x, const NoisePrior& prior, const std::vector<OdometryJump>& jumps) {
  const auto least = values(prior.least);
  const auto at = [&](std::size_t i) { return least[i] * std::exp(x[i]); };
  return {{at(0), at(1), at(2), at(3), at(4), at(kSuspicionIndex)}, std::exp(x[kLoopIndex]), jumps};
}

double penalty(const LogFactors& x, const NoisePrior& prior) {
  double sum = 0.5 * x[kLoopIndex] * x[kLoopIndex] / (kLogSigmaLoop * kLogSigmaLoop);
  for (std::size_t i = 0; i < kLoopIndex; ++i) sum += prior.evidence * x[i] * (i < kWalks ? 1.0 : kSteadyShare);
  return sum;
}

struct Fit {
  NoiseEstimate noise;
  double cost = 0.0;
};

/// The walks are doubted step by step only: coherent errors of a few loops look like a restless odometry from afar. A
/// steady drift shows only from afar.
constexpr double kMaxWalkStep = 0.8;

struct Steps {
  double first, last;
};
constexpr Steps kWide{3.2, 0.1}, kNear{0.8, 0.15};  ///< of the logarithms

Fit fit_noise(const InnovationModel& model, const NoisePrior& prior, const NoiseEstimate& start, const Steps& steps) {
  LogFactors lows{}, highs{}, best{};
  highs.fill(std::log(prior.factor_max));
  highs[kLoopIndex] = kMaxLogLoop;
  best[kLoopIndex] = std::log(start.loop_factor);
  const auto least = values(prior.least), first = values(start.odometry);
  for (std::size_t i = 0; i < kLoopIndex; ++i) {
    if (least[i] <= 0.0) highs[i] = 0.0;  // switched off
    if (i == kSuspicionIndex) highs[i] = -std::log(std::max(least[i], 1e-9));
    best[i] = least[i] > 0.0 && first[i] > 0.0 ? std::log(first[i] / least[i]) : 0.0;
  }
  for (std::size_t i = 0; i < best.size(); ++i) best[i] = std::clamp(best[i], lows[i], highs[i]);
  const auto cost = [&](const LogFactors& x) {
    const NoiseEstimate estimate = to_estimate(x, prior, {});
    return model.cost(estimate.odometry, estimate.loop_factor) + penalty(x, prior);
  };
  double best_cost = cost(best);
  // Compass search: a few smooth parameters, each evaluation one small Cholesky.
  for (double step = steps.first; step > steps.last;) {
    bool moved = false;
    for (std::size_t i = 0; i < best.size(); ++i) {
      for (const double sign : {1.0, -1.0}) {
        LogFactors x = best;
        x[i] = std::clamp(x[i] + sign * std::min(step, i < kWalks ? kMaxWalkStep : step), lows[i], highs[i]);
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
  return {to_estimate(best, prior, start.jumps), best_cost};
}

/// Log likelihood that a jump must bring: where and how far it is are free.
constexpr double kJumpPrice = 12.0;

}  // namespace

NoiseEstimate estimate_noise(const InnovationModel& model, const NoisePrior& prior, const NoiseEstimate& start) {
  return fit_noise(model, prior, start, kWide).noise;
}

NoiseEstimate estimate_noise_and_jumps(InnovationModel* model, const NoisePrior& prior, const NoiseEstimate& start,
                                       int max_new_jumps, double* cost) {
  model->set_jumps(start.jumps);
  // Suspects come first: from next to no suspicion a step up may bring nothing where full suspicion does.
  NoiseEstimate suspicious = start;
  suspicious.odometry.suspicion = 1.0;
  Fit best = fit_noise(*model, prior, suspicious, kWide);
  best.cost += kJumpPrice * static_cast<double>(best.noise.jumps.size());
  const auto attempt = [&](const std::vector<OdometryJump>& jumps) {
    model->set_jumps(jumps);
    NoiseEstimate next = best.noise;
    next.jumps = jumps;
    Fit fit = fit_noise(*model, prior, next, kNear);
    fit.cost += kJumpPrice * static_cast<double>(jumps.size());
    const bool is_better = fit.cost < best.cost;
    if (is_better) best = std::move(fit);
    model->set_jumps(best.noise.jumps);
    return is_better;
  };
  for (std::size_t i = best.noise.jumps.size(); i-- > 0;) {
    std::vector<OdometryJump> fewer = best.noise.jumps;
    fewer.erase(fewer.begin() + static_cast<std::ptrdiff_t>(i));
    attempt(fewer);
  }
  for (int i = 0; i < max_new_jumps; ++i) {
    const auto candidate = model->best_jump(best.noise, 0.5 * kJumpPrice);
    if (!candidate) break;
    std::vector<OdometryJump> more = best.noise.jumps;
    more.push_back(candidate->jump);
    if (!attempt(more)) break;
  }
  if (cost != nullptr) *cost = best.cost;
  return best.noise;
}

double robust_noise_factor(const std::vector<double>& explaining_factors, const std::vector<double>& weights) {
  std::vector<std::pair<double, double>> factors{{1.0, 1.0}};  // factor, weight
  double total = 1.0;
  for (std::size_t k = 0; k < explaining_factors.size(); ++k) {
    factors.emplace_back(explaining_factors[k], weights[k]);
    total += weights[k];
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
