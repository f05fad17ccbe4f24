#pragma once

#include <algorithm>
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

/// At most `count` of the items, evenly taken, in their order.
template <class Item>
std::vector<Item> evenly_taken(std::vector<Item> items, std::size_t count) {
  if (items.size() <= count) return items;
  std::vector<Item> some;
  for (std::size_t i = 0; i < count; ++i) some.push_back(items[i * items.size() / count]);
  return some;
}

}  // namespace semantic_topo_loop::core
