#include "semantic_topo_loop/pipeline/object_slam.h"

#include <gtest/gtest.h>

namespace semantic_topo_loop::core {
namespace {

SE3 at(double x) { return {Quaternion::Identity(), Vec3(x, 0.0, 0.0)}; }

LocalMap submap_at(std::int64_t keyframe_id, double x) {
  LocalMap submap;
  submap.keyframe_id = keyframe_id;
  submap.T_odom_anchor = at(x);
  submap.objects.emplace_back();
  submap.objects.back().spheroid.center = Vec3(0.0, 0.0, 1.0);
  return submap;
}

TEST(MoveToMap, SolvedAnchorsTakeTheirKeyframesPoseAndScaleOthersTheLast) {
  std::vector<LocalMap> submaps{submap_at(3, 1.0), submap_at(8, 2.0)};
  const std::vector<KeyframePose> keyframes{{3, 30, 0, at(10.0), 2.0}, {5, 50, 0, at(20.0), 3.0}};
  move_to_map(keyframes, at(100.0), &submaps);
  rescale(keyframes, &submaps);
  EXPECT_EQ(submaps[0].T_odom_anchor.t.x(), 10.0);
  EXPECT_EQ(submaps[0].objects[0].spheroid.center.z(), 2.0);
  EXPECT_EQ(submaps[1].T_odom_anchor.t.x(), 102.0);
  EXPECT_EQ(submaps[1].objects[0].spheroid.center.z(), 3.0);
}

}  // namespace
}  // namespace semantic_topo_loop::core
