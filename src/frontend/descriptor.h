#pragma once

#include <array>
#include <cstdint>

namespace semantic_topo_loop::core {

/// 256 bits of an ORB feature.
using Descriptor = std::array<std::uint64_t, 4>;

/// Number of bits that differ.
inline int hamming(const Descriptor& a, const Descriptor& b) {
  // Bits are counted in parallel within each word; four words' counts of nibbles fit in the bytes of one.
  constexpr std::uint64_t k1 = 0x5555555555555555ULL, k2 = 0x3333333333333333ULL, k4 = 0x0f0f0f0f0f0f0f0fULL;
  std::uint64_t bytes = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    std::uint64_t x = a[i] ^ b[i];
    x -= (x >> 1) & k1;
    x = (x & k2) + ((x >> 2) & k2);
    bytes += (x + (x >> 4)) & k4;
  }
  // Bytes hold up to 32 each, so their sum of up to 256 needs more than eight bits.
  constexpr std::uint64_t kEven = 0x00ff00ff00ff00ffULL;
  const std::uint64_t pairs = (bytes & kEven) + ((bytes >> 8) & kEven);
  return static_cast<int>((pairs * 0x0001000100010001ULL) >> 48);
}

}  // namespace semantic_topo_loop::core
