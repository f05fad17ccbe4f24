#pragma once

#include <algorithm>
#include <cstddef>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {

/// Where x is in two frames, which tells where b is in a.
struct PosePair {
  SE3 T_a_x, T_b_x;
};

/// Whether T_a_b has x in one place, within what loops may be off.
inline bool agrees(const PosePair& pair, const SE3& T_a_b) {
  constexpr double kAgreement_m = 0.5;     // three times the largest sigma of an accepted loop (loop.max_sigma_m)
  constexpr double kAgreement_rad = 0.26;  // 15 deg, three times loop.max_sigma_deg
  const SE3 T_a_x = T_a_b * pair.T_b_x;
  return (T_a_x.t - pair.T_a_x.t).norm() < kAgreement_m && rotation_angle(T_a_x.q, pair.T_a_x.q) < kAgreement_rad;
}

struct PoseConsensus {
  SE3 T_a_b;
  std::size_t supporters = 0;  ///< pairs that agree with it
};

/// @tparam Pairs a sequence of PosePair or what derives from it, as below
template <class Pairs>
std::size_t count_supporters(const Pairs& pairs, const SE3& T_a_b) {
  const auto count = std::count_if(pairs.begin(), pairs.end(), [&](const auto& pair) { return agrees(pair, T_a_b); });
  return static_cast<std::size_t>(count);
}

/// Of what each pair says by itself that with which most of them agree; `best` if none has more supporters.
template <class Pairs>
PoseConsensus most_supported(const Pairs& pairs, PoseConsensus best = {}) {
  constexpr std::size_t kMaxHypotheses = 50;  // pairs whose supporters are counted, spread evenly
  for (std::size_t i = 0; i < pairs.size(); i += 1 + pairs.size() / kMaxHypotheses) {
    const SE3 T_a_b = pairs[i].T_a_x * pairs[i].T_b_x.inverse();
    const std::size_t supporters = count_supporters(pairs, T_a_b);
    if (supporters > best.supporters) best = {T_a_b, supporters};
  }
  return best;
}

}  // namespace semantic_topo_loop::core
