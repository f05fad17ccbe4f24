#include "loop/graph/submap_index.h"

#include <algorithm>
#include <cmath>

namespace semantic_topo_loop::core {
namespace {

/// Calls f(label, label, distance) for every pair of usable points.
template <class F>
void for_each_pair(const std::vector<LabelledPoint>& points, double min_distance_m, F f) {
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (points[i].label < 0) continue;
    for (std::size_t j = i + 1; j < points.size(); ++j) {
      const double distance = (points[i].position - points[j].position).norm();
      if (points[j].label < 0 || !(distance > min_distance_m) || !std::isfinite(distance)) continue;
      f(points[i].label, points[j].label, distance);
    }
  }
}

}  // namespace

SubmapIndex::Key SubmapIndex::key(int label_p, int label_q, int bin) {
  const auto low = static_cast<Key>(std::min(label_p, label_q)), high = static_cast<Key>(std::max(label_p, label_q));
  return low << 40 | high << 20 | static_cast<Key>(bin);
}

int SubmapIndex::bin(double distance_m) const {
  constexpr double kMaxBin = 1e6;
  return static_cast<int>(std::min(std::max(distance_m, 0.0) / options_.distance_tolerance_m, kMaxBin));
}

void SubmapIndex::insert(const std::vector<LabelledPoint>& points) {
  for_each_pair(points, options_.min_distance_m, [this](int p, int q, double distance) {
    std::vector<int>& submaps = submaps_of_[key(p, q, bin(distance))];
    if (submaps.empty() || submaps.back() != size_) submaps.push_back(size_);
  });
  ++size_;
}

std::vector<int> SubmapIndex::agreeing_pairs(const std::vector<LabelledPoint>& points, int end) const {
  std::vector<int> edges(static_cast<std::size_t>(std::max(end, 0)), 0);
  std::vector<int> last_pair(edges.size(), -1);
  int pair = 0;
  for_each_pair(points, options_.min_distance_m, [&](int p, int q, double distance) {
    const double tolerance = options_.distance_tolerance_m + options_.distance_tolerance_share * distance;
    for (int b = bin(distance - tolerance); b <= bin(distance + tolerance); ++b) {
      const auto entry = submaps_of_.find(key(p, q, b));
      if (entry == submaps_of_.end()) continue;
      for (const int submap : entry->second) {
        if (submap >= end) break;
        int& last = last_pair[static_cast<std::size_t>(submap)];
        if (last == pair) continue;
        last = pair;
        ++edges[static_cast<std::size_t>(submap)];
      }
    }
    ++pair;
  });
  return edges;
}

std::vector<int> SubmapIndex::query(const std::vector<LabelledPoint>& points, int end) const {
  const std::vector<int> edges = agreeing_pairs(points, end);
  std::vector<int> candidates;
  for (int submap = 0; submap < end; ++submap) {
    if (edges[static_cast<std::size_t>(submap)] >= options_.min_edges) candidates.push_back(submap);
  }
  if (static_cast<int>(candidates.size()) > options_.max_candidates) {
    std::stable_sort(candidates.begin(), candidates.end(), [&edges](int p, int q) {
      return edges[static_cast<std::size_t>(p)] > edges[static_cast<std::size_t>(q)];
    });
    candidates.resize(static_cast<std::size_t>(options_.max_candidates));
    std::sort(candidates.begin(), candidates.end());
  }
  return candidates;
}

}  // namespace semantic_topo_loop::core
