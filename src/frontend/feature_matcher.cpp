#include "frontend/feature_matcher.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace semantic_topo_loop::core {
namespace {

constexpr int kFar = std::numeric_limits<int>::max();

struct TwoBest {
  int best = kFar, second = kFar, index = -1, level = -1, second_level = -1;
  void offer(int distance, int candidate, int candidate_level) {
    if (distance < best) {
      second = best, second_level = level;
      best = distance, index = candidate, level = candidate_level;
    } else if (distance < second) {
      second = distance, second_level = candidate_level;
    }
  }
};

/// Drops matches whose features turned otherwise than most: a camera turns all of them by about the same angle.
class RotationCheck {
 public:
  void add(std::size_t match, float from_deg, float to_deg) {
    float turn = to_deg - from_deg;
    if (turn < 0.0F) turn += 360.0F;
    const auto bin = static_cast<std::size_t>(turn * kBins / 360.0F) % kBins;
    bins_[bin].push_back(match);
  }
  template <class Drop>
  void drop_others(Drop drop) const {
    // A bin and its two neighbours: the turn may lie at the edge of a bin.
    std::size_t best = 0, most = 0;
    for (std::size_t bin = 0; bin < kBins; ++bin) {
      const std::size_t count =
          bins_[bin].size() + bins_[(bin + 1) % kBins].size() + bins_[(bin + kBins - 1) % kBins].size();
      if (count > most) most = count, best = bin;
    }
    for (std::size_t bin = 0; bin < kBins; ++bin) {
      const std::size_t distance = (bin + kBins - best) % kBins;
      if (distance <= 1 || distance == kBins - 1) continue;
      for (const std::size_t match : bins_[bin]) drop(match);
    }
  }

 private:
  static constexpr std::size_t kBins = 24;
  std::array<std::vector<std::size_t>, kBins> bins_;
};

}  // namespace

std::vector<int> search(const std::vector<SearchItem>& items, const ImageFeatures& image,
                        const std::vector<bool>& is_taken, int max_bits, double ratio) {
  std::vector<int> matches(items.size(), -1), distance_of(image.size(), kFar), owner(image.size(), -1);
  std::vector<int> candidates;
  for (std::size_t i = 0; i < items.size(); ++i) {
    const SearchItem& item = items[i];
    image.near(item.pixel, item.radius_px, &candidates);
    TwoBest found;
    for (const int candidate : candidates) {
      const auto index = static_cast<std::size_t>(candidate);
      const int level = image.features[index].level;
      if (is_taken[index] || std::abs(level - item.level) > 1) continue;
      found.offer(hamming(item.descriptor, image.descriptors[index]), candidate, level);
    }
    if (found.best > max_bits) continue;
    if (found.second != kFar && found.second_level == found.level && found.best > ratio * found.second) continue;
    const auto index = static_cast<std::size_t>(found.index);
    if (found.best >= distance_of[index]) continue;
    if (owner[index] >= 0) matches[static_cast<std::size_t>(owner[index])] = -1;
    distance_of[index] = found.best;
    owner[index] = static_cast<int>(i);
    matches[i] = found.index;
  }
  RotationCheck check;
  for (std::size_t i = 0; i < items.size(); ++i) {
    if (matches[i] < 0 || items[i].angle_deg < 0.0F) continue;
    check.add(i, items[i].angle_deg, image.features[static_cast<std::size_t>(matches[i])].angle_deg);
  }
  check.drop_others([&matches](std::size_t i) { matches[i] = -1; });
  return matches;
}

std::vector<int> match_anywhere(const ImageFeatures& a, const std::vector<bool>& wanted, const ImageFeatures& b) {
  constexpr int kMaxBits = 80, kMaxLevels = 3;
  constexpr double kRatio = 0.95, kMaxMotion_px = 240.0;
  std::vector<TwoBest> of_a(a.size()), of_b(b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    if (!wanted[i]) continue;
    for (std::size_t j = 0; j < b.size(); ++j) {
      const Vec2 motion = b.features[j].pixel - a.features[i].pixel;
      if (motion.cwiseAbs().maxCoeff() > kMaxMotion_px) continue;
      if (std::abs(a.features[i].level - b.features[j].level) > kMaxLevels) continue;
      const int distance = hamming(a.descriptors[i], b.descriptors[j]);
      of_a[i].offer(distance, static_cast<int>(j), 0);
      of_b[j].offer(distance, static_cast<int>(i), 0);
    }
  }
  std::vector<int> matches(a.size(), -1);
  RotationCheck check;
  for (std::size_t i = 0; i < a.size(); ++i) {
    const TwoBest& found = of_a[i];
    if (found.index < 0 || found.best > kMaxBits || found.best > kRatio * found.second) continue;
    const auto j = static_cast<std::size_t>(found.index);
    if (of_b[j].index != static_cast<int>(i)) continue;
    matches[i] = found.index;
    check.add(i, a.features[i].angle_deg, b.features[j].angle_deg);
  }
  check.drop_others([&matches](std::size_t i) { matches[i] = -1; });
  return matches;
}

}  // namespace semantic_topo_loop::core
