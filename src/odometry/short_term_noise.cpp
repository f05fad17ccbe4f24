#include "odometry/short_term_noise.h"

#include <cmath>
#include <tuple>
#include <utility>

namespace semantic_topo_loop::core {
namespace {

// Chosen on the shared drifted_real files of fr2_desk and fr3_office, judged on those in drifted, which are made
// differently.
constexpr double kMemory_s = 20.0;  ///< in which evidence is forgotten
/// What an odometry is at least off by, a root second or a second, and the degrees of freedom that this counts as.
constexpr double kLeast_m = 0.0005, kLeastCount = 3.0;
/// Metres that a radian is worth, since the boxes of few objects do not tell turning from moving: the distance at which
/// they are usually seen. Degrees of freedom by which errors of the two, and of both together, are held to each other.
constexpr double kLever_m = 1.4, kTogetherCount = 30.0;

double squared(double x) { return x * x; }

double variance(const VarianceEvidence& evidence, double prior, double count) {
  return (evidence.squares + count * prior) / (evidence.count + count);
}

/// Sigmas of two kinds of errors that are usually as large, a radian being worth kLever_m.
std::pair<double, double> sigmas(const VarianceEvidence& translation, const VarianceEvidence& rotation) {
  const double lever2 = squared(kLever_m);
  const VarianceEvidence both{translation.squares + lever2 * rotation.squares, translation.count + rotation.count};
  const double together = variance(both, squared(kLeast_m), 2.0 * kLeastCount);
  return {std::sqrt(variance(translation, together, kTogetherCount)),
          std::sqrt(variance(rotation, together / lever2, kTogetherCount))};
}

}  // namespace

void ShortTermNoiseEstimator::add(const Vec6& error, const Vec6& variances, const Vec6& prior, double per_square,
                                  VarianceEvidence* translation, VarianceEvidence* rotation, VarianceEvidence* all) {
  const Vec6 determined = Vec6::Ones() - variances.cwiseQuotient(prior);
  translation->squares += per_square * error.head<3>().squaredNorm();
  rotation->squares += per_square * error.tail<3>().squaredNorm();
  translation->count += determined.head<3>().sum();
  rotation->count += determined.tail<3>().sum();
  all->squares += error.dot(error.cwiseQuotient(prior));
  all->count += determined.sum();
}

void ShortTermNoiseEstimator::forget(double elapsed_s) {
  const double share = std::exp(-elapsed_s / kMemory_s);
  for (VarianceEvidence* part : {&step_translation_, &step_rotation_, &drift_translation_, &drift_rotation_}) {
    part->squares *= share;
    part->count *= share;
  }
}

ShortTermNoise ShortTermNoiseEstimator::noise() const {
  ShortTermNoise noise;
  std::tie(noise.step_m, noise.step_rad) = sigmas(step_translation_, step_rotation_);
  std::tie(noise.drift_mps, noise.drift_radps) = sigmas(drift_translation_, drift_rotation_);
  return noise;
}

}  // namespace semantic_topo_loop::core
