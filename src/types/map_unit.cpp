#include "semantic_topo_loop/types/map_unit.h"

#include <cmath>
#include <map>

namespace semantic_topo_loop::core {
namespace {

/// Of the logarithms of sizes: by how much a class's typical one is off where one is, the objects of a class from each
/// other there, and all of a table together. With COCO's table: 0.26 to 0.32 on fr2_desk, fr3_office and fr1_xyz for
/// the first; units of 1.17 and 1.09 m for one of 1 m on the first two.
constexpr double kClassSigma = 0.28, kObjectSigma = 0.2, kTableSigma = 0.1;
constexpr double kDoubt = 2.0;  ///< sigmas, from which on a class counts less
constexpr std::size_t kMinClasses = 3;

}  // namespace

std::optional<MapUnit> map_unit(const std::vector<Landmark>& landmarks, const ClassTable& classes) {
  struct Logarithms {
    double sum = 0.0;
    int count = 0;
  };
  std::map<int, Logarithms> by_class;
  MapUnit unit;
  for (const Landmark& landmark : landmarks) {
    const ObjectClass* object_class = classes.find(landmark.class_id);
    if (landmark.state != LandmarkState::kConfirmed || !landmark.ellipsoid || object_class == nullptr) continue;
    const double diameter = 2.0 * std::sqrt(landmark.ellipsoid->semi_axes.squaredNorm() / 3.0);
    if (!(diameter > 0.0) || !(object_class->size_prior_m > 0.0)) continue;
    Logarithms& of_class = by_class[landmark.class_id];
    of_class.sum += std::log(object_class->size_prior_m / diameter);
    ++of_class.count;
    ++unit.objects;
  }
  if (by_class.size() < kMinClasses) return std::nullopt;
  unit.classes = static_cast<int>(by_class.size());
  double mean = 0.0, information = 0.0;
  constexpr int kIterations = 20;  // of reweighting: a fixed number
  for (int i = 0; i < kIterations; ++i) {
    double sum = 0.0, weights = 0.0;
    for (const auto& [class_id, logs] : by_class) {
      const double variance = kClassSigma * kClassSigma + kObjectSigma * kObjectSigma / logs.count;
      const double off = logs.sum / logs.count - mean;
      const double sigmas2 = off * off / variance;
      // All count in full at first.
      const double weight = (i == 0 ? 1.0 : 1.0 / (1.0 + sigmas2 / (kDoubt * kDoubt))) / variance;
      sum += weight * (logs.sum / logs.count);
      weights += weight;
    }
    mean = sum / weights;
    information = weights;
  }
  unit.metres = std::exp(mean);
  unit.sigma = std::hypot(1.0 / std::sqrt(information), kTableSigma);
  return unit;
}

}  // namespace semantic_topo_loop::core
