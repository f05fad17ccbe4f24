#include "loop/graph/box_tracker.h"

#include <gtest/gtest.h>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::int64_t kFrameNs = 33'000'000;

TrackedBox box_at(double x, double y, int class_id = 1, double size = 0.1) {
  return {{x - 0.5 * size, y - 0.5 * size, x + 0.5 * size, y + 0.5 * size}, class_id, 0.9};
}

/// A box about the direction of a point, seen by a camera of that rotation.
TrackedBox box_of(const Vec3& point, const Quaternion& q_world_camera, int class_id = 1) {
  const Vec3 p = q_world_camera.conjugate() * point;
  return box_at(p.x() / p.z(), p.y() / p.z(), class_id);
}

TEST(BoxTracker, FollowsThroughTurnsAndGaps) {
  BoxTracker tracker;
  std::int64_t first = -1, second = -1;
  for (int k = 0; k < 40; ++k) {
    const Quaternion q = so3_exp(Vec3(0.01 * k, -0.03 * k, 0.0));  // 50 deg a second: half a box from frame to frame
    std::vector<TrackedBox> boxes = {box_of(Vec3(-0.5, 0.0, 2.0), q), box_of(Vec3(0.4, 0.1, 2.0), q, 2)};
    if (k % 10 >= 4 && k % 10 < 8) boxes.pop_back();
    tracker.follow(k * kFrameNs, q, &boxes);
    if (k == 0) first = boxes[0].track_id;
    if (k == 0) second = boxes[1].track_id;
    EXPECT_EQ(boxes[0].track_id, first) << k;
    if (boxes.size() > 1) {
      EXPECT_EQ(boxes[1].track_id, second) << k;
    }
  }
  EXPECT_NE(first, second);
}

TEST(BoxTracker, TheCommonestClassIsTheTracks) {
  BoxTracker tracker;
  std::vector<TrackedBox> boxes;
  for (int k = 0; k < 10; ++k) {
    boxes = {box_at(0.0, 0.0, k % 3 == 2 ? 5 : 7)};
    tracker.follow(k * kFrameNs, Quaternion::Identity(), &boxes);
    EXPECT_EQ(boxes[0].track_id, 0);
    EXPECT_EQ(boxes[0].track_class_id, 7);
  }
}

TEST(BoxTracker, TakesTheBoxThatOverlapsMost) {
  BoxTracker tracker;
  std::vector<TrackedBox> boxes = {box_at(0.0, 0.0), box_at(0.07, 0.0)};
  tracker.follow(0, Quaternion::Identity(), &boxes);
  std::vector<TrackedBox> next = {box_at(0.075, 0.0), box_at(0.005, 0.0)};
  tracker.follow(kFrameNs, Quaternion::Identity(), &next);
  EXPECT_EQ(next[0].track_id, boxes[1].track_id);
  EXPECT_EQ(next[1].track_id, boxes[0].track_id);
}

TEST(BoxTracker, EndsTracksAfterAWhileAndWhenTold) {
  BoxTracker tracker;
  std::vector<TrackedBox> boxes = {box_at(0.0, 0.0)}, later = boxes, last = boxes;
  tracker.follow(0, Quaternion::Identity(), &boxes);
  tracker.follow(1'000'000'000, Quaternion::Identity(), &later);
  EXPECT_NE(later[0].track_id, boxes[0].track_id);
  tracker.clear();
  tracker.follow(1'000'000'000 + kFrameNs, Quaternion::Identity(), &last);
  EXPECT_NE(last[0].track_id, later[0].track_id);
  std::vector<TrackedBox> none;
  tracker.follow(2'000'000'000, Quaternion::Identity(), &none);
  EXPECT_TRUE(none.empty());
}

}  // namespace
}  // namespace semantic_topo_loop::core
