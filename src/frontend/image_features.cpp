#include "frontend/image_features.h"

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
  static constexpr std::size_t kBins = 24;  ///< of 15 deg: the orientation of a corner is known to several degrees
  std::array<std::vector<std::size_t>, kBins> bins_;
};

}  // namespace

void ImageFeatures::index(const Camera& camera) {
  constexpr int kCell_px = 20;  // about the radius of a search: few cells to visit, and few features in vain
  grid_ = PointGrid(camera.width / kCell_px + 1, camera.height / kCell_px + 1, kCell_px);
  grid_.sort(size(), [this](std::size_t i) -> const Vec2& { return features[i].pixel; });
}

void ImageFeatures::near(const Vec2& pixel, double radius_px, std::vector<int>* found) const {
  found->clear();
  if (features.empty()) return;
  const Box square{pixel.x() - radius_px, pixel.y() - radius_px, pixel.x() + radius_px, pixel.y() + radius_px};
  grid_.for_each_row(square, [&](std::uint32_t begin, std::uint32_t end) {
    for (std::uint32_t i = begin; i < end; ++i) {
      const std::uint32_t index = grid_.order()[i];
      const Vec2 offset = features[index].pixel - pixel;
      if (std::abs(offset.x()) <= radius_px && std::abs(offset.y()) <= radius_px) {
        found->push_back(static_cast<int>(index));
      }
    }
  });
}

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
  // Loose, for the pose that is sought from these matches may have most of them wrong, but must have the right ones.
  constexpr int kMaxBits = 80;             // between kSimilarBits and kMatchBits
  constexpr double kRatio = 0.95;          // of the best to the second best: ties only are left out
  constexpr int kMaxLevels = 3;            // 1.2^3: nearer or farther by 1.7 times
  constexpr double kMaxMotion_px = 240.0;  // half a 640 x 480 image's height; what moved farther has left many views
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
