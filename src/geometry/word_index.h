#pragma once

#include <cstdint>
#include <unordered_map>
#include <vector>

namespace semantic_topo_loop::core {

/// Which of many images have a visual word: what one has in common with each of them, without comparing it with each.
class WordIndex {
 public:
  /// @param id above those before   @param words visual_words of its features
  void insert(int id, const std::vector<std::uint32_t>& words);
  /// @param words as they were inserted
  void erase(int id, const std::vector<std::uint32_t>& words);
  /// How many of these words each image has, by id; one that both have n times counts n times. What has none may be
  /// left out at the end.
  std::vector<int> common(const std::vector<std::uint32_t>& words) const;

 private:
  std::unordered_map<std::uint32_t, std::vector<int>> images_of_;  ///< looked up only; as often as each has it
  std::size_t end_ = 0;                                            ///< behind the largest id
};

}  // namespace semantic_topo_loop::core
