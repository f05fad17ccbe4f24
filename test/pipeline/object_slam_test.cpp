#include "semantic_topo_loop/pipeline/object_slam.h"

#include <gtest/gtest.h>

#include <cmath>

#include "support/simulated_run.h"
#include "support/test_fixtures.h"

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

/// The sequence as a camera with `factor` times as many pixels a side sees it, without what a grid of pixels blurs.
SimulatedSequence enlarged(SimulatedSequence sequence, double factor) {
  Camera& camera = sequence.camera;
  for (double* value : {&camera.fx, &camera.fy, &camera.cx, &camera.cy}) *value *= factor;
  camera.width = static_cast<int>(std::lround(factor * camera.width));
  camera.height = static_cast<int>(std::lround(factor * camera.height));
  for (auto& frame : sequence.detections) {
    for (SimulatedDetection& d : frame) {
      Box& box = d.detection.box;
      box = {factor * box.x1, factor * box.y1, factor * box.x2, factor * box.y2};
    }
  }
  return sequence;
}

TEST(ObjectSlam, TheSameSceneInMorePixelsIsTheSameMap) {
  const auto classes = shared_coco();
  const SimulatedSequence sequence = simulation_test::simulate_fr2({{"trajectory.duration_s", "60"},
                                                                    {"trajectory.lap_s", "30"},
                                                                    {"trajectory.rate_hz", "10"},
                                                                    {"drift.position_m", "0.3"},
                                                                    {"drift.rotation_deg", "3"}},
                                                                   *classes);
  const SimulatedSequence wide_sequence = enlarged(sequence, 4.0);
  testing::ChainRun vga(sequence, classes), wide(wide_sequence, classes);
  for (testing::ChainRun* run : {&vga, &wide}) {
    while (run->done() < sequence.odometry.size()) run->next();
    run->end();
  }
  ASSERT_GE(vga.corrections(), 1);
  const auto poses = vga.slam().pose_graph().keyframes(), wide_poses = wide.slam().pose_graph().keyframes();
  ASSERT_EQ(poses.size(), wide_poses.size());
  for (std::size_t i = 0; i < poses.size(); ++i) {
    ASSERT_LT((poses[i].T_map_camera.t - wide_poses[i].T_map_camera.t).norm(), 1e-6) << i;
  }
  const auto& landmarks = vga.slam().mapper().landmarks();
  const auto& wide_landmarks = wide.slam().mapper().landmarks();
  ASSERT_EQ(landmarks.size(), wide_landmarks.size());
  for (std::size_t i = 0; i < landmarks.size(); ++i) {
    ASSERT_EQ(landmarks[i].state, wide_landmarks[i].state) << landmarks[i].id;
    if (!landmarks[i].ellipsoid) continue;
    const Ellipsoid &a = *landmarks[i].ellipsoid, &b = *wide_landmarks[i].ellipsoid;
    EXPECT_LT((a.center() - b.center()).norm() + (a.semi_axes - b.semi_axes).norm(), 1e-6) << landmarks[i].id;
  }
}

}  // namespace
}  // namespace semantic_topo_loop::core
