#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace semantic_topo_loop::core {

/// Upper median; 0 for no values.
inline double median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// The smallest value that a share of all is not above (nearest rank); 0 for no values.
inline double quantile(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  const double rank = std::ceil(share * static_cast<double>(values.size()));  // counted from 1
  const auto place = values.begin() + static_cast<std::ptrdiff_t>(std::max(rank, 1.0)) - 1;
  std::nth_element(values.begin(), place, values.end());
  return *place;
}

/// The key with the greatest value, the lowest on ties.
template <class Map>
typename Map::key_type with_most(const Map& values) {
  return std::max_element(values.begin(), values.end(),
                          [](const auto& p, const auto& q) { return p.second < q.second; })
      ->first;
}

/// At most `count` of the items, evenly taken, in their order.
template <class Item>
std::vector<Item> evenly_taken(std::vector<Item> items, std::size_t count) {
  if (items.size() <= count) return items;
  std::vector<Item> some;
  for (std::size_t i = 0; i < count; ++i) some.push_back(items[i * items.size() / count]);
  return some;
}

/// Up to `count` elements, evenly spread, first and last included.
template <class T>
std::vector<T> spread(const std::vector<T>& values, std::size_t count) {
  if (values.size() <= count) return values;
  std::vector<T> result;
  result.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    result.push_back(values[count == 1 ? values.size() / 2 : i * (values.size() - 1) / (count - 1)]);
  }
  return result;
}

/// Every second one goes, and its memory with it.
template <class T>
void halve(std::vector<T>* values) {
  std::size_t kept = 0;
  for (std::size_t i = 0; i < values->size(); i += 2) (*values)[kept++] = (*values)[i];
  values->resize(kept);
  values->shrink_to_fit();
}

}  // namespace semantic_topo_loop::core
