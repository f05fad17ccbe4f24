#pragma once

#include <random>

#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// Seeded random vectors and poses for tests.
class RandomPoses {
 public:
  explicit RandomPoses(std::uint64_t seed) : engine_(seed) {}

  double uniform(double low, double high) { return std::uniform_real_distribution<double>(low, high)(engine_); }
  Vec3 vector(double size) { return {uniform(-size, size), uniform(-size, size), uniform(-size, size)}; }
  Quaternion rotation() {
    std::normal_distribution<double> normal;
    return Quaternion(normal(engine_), normal(engine_), normal(engine_), normal(engine_)).normalized();
  }
  SE3 pose(double size) {
    const Quaternion q = rotation();
    return {q, vector(size)};
  }

 private:
  std::mt19937_64 engine_;
};

}  // namespace semantic_topo_loop::core
