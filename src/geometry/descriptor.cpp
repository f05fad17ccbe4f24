#include "geometry/descriptor.h"

#include <algorithm>

namespace semantic_topo_loop::core {

std::vector<std::uint32_t> visual_words(const std::vector<Descriptor>& descriptors) {
  constexpr std::uint32_t kBits = 16;
  std::vector<std::uint32_t> words;
  words.reserve(4 * descriptors.size());
  for (const Descriptor& descriptor : descriptors) {
    for (std::uint32_t part = 0; part < descriptor.size(); ++part) {
      words.push_back(part << kBits | static_cast<std::uint32_t>(descriptor[part] & 0xFFFF));
    }
  }
  std::sort(words.begin(), words.end());
  return words;
}

}  // namespace semantic_topo_loop::core
