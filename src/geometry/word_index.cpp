#include "geometry/word_index.h"

#include <algorithm>

namespace semantic_topo_loop::core {

void WordIndex::insert(int id, const std::vector<std::uint32_t>& words) {
  for (const std::uint32_t word : words) images_of_[word].push_back(id);
  end_ = static_cast<std::size_t>(id) + 1;
}

void WordIndex::erase(int id, const std::vector<std::uint32_t>& words) {
  for (const std::uint32_t word : words) {
    const auto entry = images_of_.find(word);
    if (entry == images_of_.end()) continue;
    const auto [begin, end] = std::equal_range(entry->second.begin(), entry->second.end(), id);
    entry->second.erase(begin, end);
    if (entry->second.empty()) images_of_.erase(entry);
  }
}

std::vector<int> WordIndex::common(const std::vector<std::uint32_t>& words) const {
  std::vector<int> counts(end_, 0);
  for (auto word = words.begin(); word != words.end();) {
    const auto next = std::find_if(word, words.end(), [word](std::uint32_t other) { return other != *word; });
    const auto times = next - word;
    const auto entry = images_of_.find(*word);
    word = next;
    if (entry == images_of_.end()) continue;
    const std::vector<int>& images = entry->second;
    for (auto image = images.begin(); image != images.end();) {
      const auto other = std::find_if(image, images.end(), [image](int id) { return id != *image; });
      counts[static_cast<std::size_t>(*image)] += static_cast<int>(std::min(times, other - image));
      image = other;
    }
  }
  return counts;
}

}  // namespace semantic_topo_loop::core
