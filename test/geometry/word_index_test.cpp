#include "geometry/word_index.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <iterator>
#include <map>
#include <random>

#include "geometry/descriptor.h"

namespace semantic_topo_loop::core {
namespace {

using Words = std::vector<std::uint32_t>;

TEST(WordIndex, CountsWhatEachImageHasInCommonAsOftenAsBothHaveIt) {
  WordIndex index;
  index.insert(2, {1, 3, 3, 3, 7});
  index.insert(5, {3, 9});
  EXPECT_EQ(index.common({1, 3, 3, 8}), (std::vector<int>{0, 0, 3, 0, 0, 1}));
  index.erase(2, {1, 3, 3, 3, 7});
  EXPECT_EQ(index.common({1, 3, 3, 8}), (std::vector<int>{0, 0, 0, 0, 0, 1}));
  EXPECT_TRUE(WordIndex().common({1}).empty());
}

TEST(WordIndex, AgreesWithTheComparisonOfEachPair) {
  std::mt19937_64 random(3);
  WordIndex index;
  std::map<int, Words> images;
  for (int id = 0; id < 60; ++id) {
    Words words;
    for (int i = 0; i < 80; ++i) words.push_back(static_cast<std::uint32_t>(random() % 100));
    std::sort(words.begin(), words.end());
    index.insert(id, words);
    images[id] = words;
    if (id % 3 == 0) continue;
    const auto removed = std::next(images.begin(), static_cast<std::ptrdiff_t>(random() % images.size()));
    index.erase(removed->first, removed->second);
    images.erase(removed);
  }
  ASSERT_GT(images.size(), 10U);
  for (const auto& [id, words] : images) {
    const std::vector<int> counts = index.common(words);
    for (int other = 0; other < static_cast<int>(counts.size()); ++other) {
      Words both;
      if (images.count(other) > 0) {
        std::set_intersection(words.begin(), words.end(), images[other].begin(), images[other].end(),
                              std::back_inserter(both));
      }
      EXPECT_EQ(counts[static_cast<std::size_t>(other)], static_cast<int>(both.size())) << id << ' ' << other;
    }
  }
}

TEST(WordIndex, WordsOfADescriptorAreFourAndTellWhere) {
  const Descriptor descriptor{0x1ABCD, 0x2ABCD, 3, 4};
  EXPECT_EQ(visual_words({descriptor}), (Words{0x0ABCD, 0x1ABCD, 0x20003, 0x30004}));
}

}  // namespace
}  // namespace semantic_topo_loop::core
