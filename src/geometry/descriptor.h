#pragma once

#include <cstdint>
#include <opencv2/core/hal/hal.hpp>
#include <vector>

#include "semantic_topo_loop/types/point_feature.h"

namespace semantic_topo_loop::core {

/// Number of bits that differ.
inline int hamming(const Descriptor& a, const Descriptor& b) {
  const auto bytes = [](const Descriptor& d) { return reinterpret_cast<const std::uint8_t*>(d.data()); };
  return cv::hal::normHamming(bytes(a), bytes(b), sizeof(Descriptor));
}

/// Bits out of 256 by which two views of one point differ at most: ORB-SLAM's thresholds (Mur-Artal, Montiel and Tardos
/// 2015). Unrelated features differ by 128 in the mean.
constexpr int kMatchBits = 100;   ///< where the place in the image is known
constexpr int kSimilarBits = 50;  ///< where a mistake would last: it joins two points of the map

/// What an image looks like, to compare it with many: four words of 16 bits a descriptor, ascending. Descriptors of one
/// point have a word in common with some 25 % (15 % of their bits differ), others by chance with one in 2^14.
std::vector<std::uint32_t> visual_words(const std::vector<Descriptor>& descriptors);

}  // namespace semantic_topo_loop::core
