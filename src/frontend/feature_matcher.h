#pragma once

#include <cstdint>
#include <vector>

#include "frontend/image_features.h"

namespace semantic_topo_loop::core {

constexpr int kMatchBits = 100;      ///< descriptors farther apart never match
constexpr int kCloseMatchBits = 50;  ///< no closer, and they match without a prior only if they differ by less

/// Where something is looked for in an image.
struct SearchItem {
  Descriptor descriptor{};
  Vec2 pixel = Vec2::Zero();
  double radius_px = 0.0;
  int level = 0;            ///< expected; one more or less is accepted
  float angle_deg = -1.0F;  ///< of the feature it was seen at before; < 0: not known
};

/// For each item the index of its feature, or -1: the most similar one within the radius, where the second best is
/// clearly less similar, each feature once.
/// @param is_taken features that are out of question
/// @param max_bits largest difference of descriptors   @param ratio best to second best, of about the same level
std::vector<int> search(const std::vector<SearchItem>& items, const ImageFeatures& image,
                        const std::vector<bool>& is_taken, int max_bits, double ratio);

/// For each feature of `a` (only those that are `wanted`) its match in `b`, or -1, up to 240 pixels away:
/// mutually most similar, clearly more than the second best, and turned like most others.
std::vector<int> match_anywhere(const ImageFeatures& a, const std::vector<bool>& wanted, const ImageFeatures& b);

}  // namespace semantic_topo_loop::core
