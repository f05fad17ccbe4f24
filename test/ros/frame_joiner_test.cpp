#include "ros/frame_joiner.h"

#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace semantic_topo_loop {
namespace {

using Joiner = FrameJoiner<int, std::string>;

TEST(FrameJoiner, JoinsInWhateverOrderTheKindsCome) {
  Joiner joiner(10);
  EXPECT_FALSE(joiner.add<0>(0, 10));
  const auto first = joiner.add<1>(0, "a");
  ASSERT_TRUE(first);
  EXPECT_EQ(*first, Joiner::Set(10, "a"));
  EXPECT_FALSE(joiner.add<1>(1, "b"));
  const auto second = joiner.add<0>(1, 11);
  ASSERT_TRUE(second);
  EXPECT_EQ(*second, Joiner::Set(11, "b"));
  EXPECT_EQ(joiner.size(), 0u);
}

TEST(FrameJoiner, EvictsOlderIncompleteFramesWhenANewerCompletes) {
  std::vector<std::int64_t> evicted;
  Joiner joiner(10, [&evicted](std::int64_t frame_id, const Joiner::Partial& partial) {
    evicted.push_back(frame_id);
    EXPECT_EQ(std::get<0>(partial).has_value(), frame_id != 2);
    EXPECT_EQ(std::get<1>(partial).has_value(), frame_id == 2);
  });
  joiner.add<0>(1, 1);
  joiner.add<1>(2, "two");
  joiner.add<0>(4, 4);
  joiner.add<0>(3, 3);
  ASSERT_TRUE(joiner.add<1>(3, "three"));
  EXPECT_EQ(evicted, (std::vector<std::int64_t>{1, 2}));
  EXPECT_EQ(joiner.evicted(), 2u);
  EXPECT_EQ(joiner.size(), 1u);
  ASSERT_TRUE(joiner.add<1>(4, "four"));
}

TEST(FrameJoiner, DoesNotGoBack) {
  Joiner joiner(10);
  joiner.add<0>(5, 5);
  ASSERT_TRUE(joiner.add<1>(5, "five"));
  EXPECT_TRUE(joiner.is_past(5));
  EXPECT_FALSE(joiner.is_past(6));
  EXPECT_FALSE(joiner.add<0>(4, 4));
  EXPECT_FALSE(joiner.add<1>(4, "four"));
  EXPECT_EQ(joiner.late(), 2u);
}

TEST(FrameJoiner, IsBounded) {
  Joiner joiner(3);
  for (int i = 0; i < 10; ++i) joiner.add<0>(i, i);
  EXPECT_EQ(joiner.size(), 3u);
  EXPECT_EQ(joiner.evicted(), 7u);
  EXPECT_FALSE(joiner.add<1>(6, "evicted already"));
  EXPECT_TRUE(joiner.add<1>(7, "oldest held"));
}

TEST(FrameJoiner, ClearBeginsAnew) {
  Joiner joiner(3);
  joiner.add<0>(5, 5);
  joiner.add<1>(5, "five");
  joiner.add<0>(6, 6);
  joiner.clear();
  joiner.add<0>(0, 0);
  EXPECT_TRUE(joiner.add<1>(0, "zero"));
}

}  // namespace
}  // namespace semantic_topo_loop
