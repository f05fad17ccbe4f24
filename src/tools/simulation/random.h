#pragma once

#include <cmath>
#include <cstdint>
#include <random>

#include "semantic_topo_loop/types/eigen.h"

namespace semantic_topo_loop::core {

/// Seeded random numbers whose values the C++ standard does not leave open: the engine is fully specified, and the
/// distributions are written out here (std::normal_distribution differs between libraries).
class Random {
 public:
  /// Different streams of one seed are independent, so that e.g. the detector's options leave the scene as it is.
  explicit Random(std::uint64_t seed, std::uint64_t stream = 0) : engine_(mix(mix(seed) + stream)) {}

  /// In [0, 1).
  double uniform() { return static_cast<double>(engine_() >> 11) * 0x1p-53; }
  double uniform(double low, double high) { return low + (high - low) * uniform(); }
  /// In [0, count), count > 0.
  int index(int count) { return static_cast<int>(uniform() * count); }
  /// In [low, high], both included.
  int integer(int low, int high) { return low + index(high - low + 1); }
  bool chance(double probability) { return uniform() < probability; }
  /// Mean 0, standard deviation 1 (Box and Muller 1958).
  double normal() {
    const double radius = std::sqrt(-2.0 * std::log(1.0 - uniform()));
    return radius * std::cos(2.0 * kPi * uniform());
  }
  Vec3 normal3() {
    Vec3 v;
    for (int i = 0; i < 3; ++i) v[i] = normal();
    return v;
  }
  /// Uniform on the unit sphere.
  Vec3 direction() {
    Vec3 v = normal3();
    while (v.norm() < 1e-6) v = normal3();
    return v.normalized();
  }
  /// Uniform over all rotations.
  Quaternion rotation() {
    Vec4 v;
    do {
      for (int i = 0; i < 4; ++i) v[i] = normal();
    } while (v.norm() < 1e-6);
    v.normalize();
    return {v[3], v[0], v[1], v[2]};
  }

 private:
  /// Finaliser of SplitMix64 (Steele, Lea and Flood 2014): neighbouring seeds give unrelated engines.
  static std::uint64_t mix(std::uint64_t x) {
    x += 0x9e3779b97f4a7c15ULL;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ULL;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebULL;
    return x ^ (x >> 31);
  }

  std::mt19937_64 engine_;
};

}  // namespace semantic_topo_loop::core
