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

int common_words(const std::vector<std::uint32_t>& a, const std::vector<std::uint32_t>& b) {
  int common = 0;
  for (auto i = a.begin(), j = b.begin(); i != a.end() && j != b.end();) {
    common += *i == *j ? 1 : 0;
    const bool i_goes = *i <= *j, j_goes = *j <= *i;
    i += i_goes ? 1 : 0;
    j += j_goes ? 1 : 0;
  }
  return common;
}

}  // namespace semantic_topo_loop::core
