#include <gtest/gtest.h>

#include "ros/map_view.h"

namespace semantic_topo_loop {
namespace {

core::MapUpdate make_update(std::uint64_t base, std::uint64_t version, const std::vector<std::int64_t>& changed) {
  core::MapUpdate update;
  update.base_version = base;
  update.map_version = version;
  for (const std::int64_t id : changed) {
    update.changed.emplace_back();
    update.changed.back().id = id;
  }
  return update;
}

TEST(MapFollower, LetsConsecutiveUpdatesThrough) {
  MapFollower follower;
  EXPECT_EQ(follower.follow(make_update(0, 1, {1})).size(), 1u);
  EXPECT_EQ(follower.follow(make_update(1, 1, {})).size(), 1u);
  EXPECT_EQ(follower.follow(make_update(1, 2, {2})).size(), 1u);
  EXPECT_EQ(follower.version(), 2u);
  EXPECT_FALSE(follower.has_gap());
  EXPECT_EQ(follower.gaps(), 0u);
}

TEST(MapFollower, IgnoresWhatItAlreadyHas) {
  MapFollower follower;
  follower.follow(make_update(0, 5, {}));
  EXPECT_TRUE(follower.follow(make_update(2, 3, {})).empty());
  EXPECT_FALSE(follower.has_gap());
}

TEST(MapFollower, BridgesAGapWithTheFullMapAndReplaysWhatFollowed) {
  MapFollower follower;
  follower.follow(make_update(0, 1, {1, 2, 3}));
  EXPECT_TRUE(follower.follow(make_update(2, 3, {4})).empty());
  EXPECT_TRUE(follower.follow(make_update(3, 4, {5})).empty());
  EXPECT_TRUE(follower.has_gap());
  EXPECT_EQ(follower.gaps(), 1u);

  const auto updates = follower.recover(make_update(0, 3, {1, 3, 4}));
  ASSERT_EQ(updates.size(), 2u);
  EXPECT_EQ(updates[0].base_version, 1u);
  EXPECT_EQ(updates[0].map_version, 3u);
  EXPECT_EQ(updates[0].removed, (std::vector<std::int64_t>{2}));
  EXPECT_EQ(updates[1].map_version, 4u);
  EXPECT_FALSE(follower.has_gap());
  EXPECT_EQ(follower.version(), 4u);
}

TEST(MapFollower, StaysInTheGapIfTheFullMapIsTooOld) {
  MapFollower follower;
  follower.follow(make_update(0, 1, {}));
  follower.follow(make_update(3, 4, {7}));
  EXPECT_EQ(follower.recover(make_update(0, 2, {})).size(), 1u);
  EXPECT_TRUE(follower.has_gap());
  const auto updates = follower.recover(make_update(0, 4, {7}));
  ASSERT_EQ(updates.size(), 1u);
  EXPECT_EQ(updates[0].base_version, 2u);
  EXPECT_FALSE(follower.has_gap());
}

TEST(MapFollower, AFullMapWithoutAGapChangesNothing) {
  MapFollower follower;
  follower.follow(make_update(0, 1, {}));
  EXPECT_TRUE(follower.recover(make_update(0, 9, {})).empty());
  EXPECT_EQ(follower.version(), 1u);
}

TEST(MapFollower, WhoJoinsLateTakesTheFullMapBeforeAnyUpdate) {
  MapFollower follower;
  follower.join_late();
  EXPECT_TRUE(follower.has_gap());
  const auto updates = follower.recover(make_update(0, 9, {1, 2}));
  ASSERT_EQ(updates.size(), 1u);
  EXPECT_EQ(updates[0].changed.size(), 2u);
  EXPECT_FALSE(follower.has_gap());
  EXPECT_EQ(follower.follow(make_update(9, 10, {3})).size(), 1u);
}

}  // namespace
}  // namespace semantic_topo_loop
