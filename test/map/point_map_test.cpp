#include "semantic_topo_loop/map/point_map.h"

#include <gtest/gtest.h>

#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

using Points = std::vector<Eigen::Vector3f>;

Frame keyframe(std::int64_t id, const SE3& T_odom_camera, KeyframePoints points) {
  Frame frame;
  frame.frame_id = 10 * id;
  frame.keyframe_id = id;
  frame.is_keyframe = true;
  frame.T_odom_camera = T_odom_camera;
  frame.keyframe_points = std::make_shared<const KeyframePoints>(std::move(points));
  return frame;
}

SE3 at(double x) { return {so3_exp(Vec3(0.0, 0.0, x)), Vec3(x, 0.0, 0.0)}; }

Points line(int count, float step) {
  Points points;
  for (int i = 0; i < count; ++i) points.emplace_back(step * static_cast<float>(i), 0.0F, 1.0F);
  return points;
}

TEST(PointMap, PlacesThePointsOfEachKeyframeAndEverySparsePointOnce) {
  PointMap map{PointMapOptions()};
  map.add(keyframe(0, at(0.0), {{{3, {0.0F, 0.0F, 1.0F}}, {7, {0.1F, 0.0F, 1.0F}}}, line(4, 0.1F)}));
  map.add(keyframe(1, at(0.5), {{{3, {0.0F, 0.0F, 2.0F}}}, {}}));
  Frame between = keyframe(1, at(0.7), {{}, line(9, 0.1F)});
  between.is_keyframe = false;
  map.add(between);
  const MapPoints points = map.points();
  EXPECT_EQ(map.keyframes(), 2U);
  ASSERT_EQ(points.sparse.size(), 2U);
  EXPECT_LT((points.sparse[0] - (at(0.5) * Vec3(0.0, 0.0, 2.0)).cast<float>()).norm(), 1e-6F) << "the newest sight";
  EXPECT_LT((points.sparse[1] - Eigen::Vector3f(0.1F, 0.0F, 1.0F)).norm(), 1e-6F);
  ASSERT_EQ(points.semi_dense.size(), 4U);
  EXPECT_LT((points.semi_dense[3] - Eigen::Vector3f(0.3F, 0.0F, 1.0F)).norm(), 1e-6F);
}

TEST(PointMap, PointsMoveWithTheirKeyframesAndNewerOnesWithTheOdometry) {
  PointMap map{PointMapOptions()};
  for (int i = 0; i < 3; ++i) map.add(keyframe(i, at(0.1 * i), {{}, line(1, 0.1F)}));
  MapCorrection correction;
  map.apply(correction);  // nothing changed
  EXPECT_LT((map.points().semi_dense[2].cast<double>() - at(0.2) * Vec3(0.0, 0.0, 1.0)).norm(), 1e-6);
  correction.changed = true;
  correction.valid_to_keyframe_id = 1;
  correction.T_map_odom = SE3(so3_exp(Vec3(0.1, 0.2, 0.3)), Vec3(1.0, 2.0, 3.0));
  const SE3 moved(so3_exp(Vec3(0.0, 0.5, 0.0)), Vec3(5.0, 0.0, 0.0));
  correction.keyframes = {{0, 0, 0, at(0.0)}, {1, 10, 0, moved}, {9, 90, 0, moved}};
  map.apply(correction);
  map.add(keyframe(3, at(0.3), {{}, line(1, 0.1F)}));
  const Points points = map.points().semi_dense;
  ASSERT_EQ(points.size(), 4U);
  const Vec3 p(0.0, 0.0, 1.0);
  EXPECT_LT((points[0].cast<double>() - at(0.0) * p).norm(), 1e-5);
  EXPECT_LT((points[1].cast<double>() - moved * p).norm(), 1e-5);
  EXPECT_LT((points[2].cast<double>() - correction.T_map_odom * (at(0.2) * p)).norm(), 1e-5);
  EXPECT_LT((points[3].cast<double>() - correction.T_map_odom * (at(0.3) * p)).norm(), 1e-5);
}

TEST(PointMap, NewKeyframesStandWhereTheLastCorrectionPutsTheOdometry) {
  PointMap map{PointMapOptions()};
  const Vec3 begin_at(1.0, 2.0, 3.0);
  map.begin_session(begin_at);
  const SE3 T_map_odom(Quaternion::Identity(), begin_at - at(0.1).t);
  map.add(keyframe(0, at(0.1), {{}, line(1, 0.1F)}));
  MapCorrection correction;
  correction.T_map_odom = at(0.7) * T_map_odom;
  map.apply(correction);  // no keyframe moved
  map.add(keyframe(1, at(0.2), {{}, line(1, 0.1F)}));
  const Points points = map.points().semi_dense;
  ASSERT_EQ(points.size(), 2U);
  EXPECT_LT((points[0].cast<double>() - T_map_odom * (at(0.1) * Vec3(0.0, 0.0, 1.0))).norm(), 1e-5);
  EXPECT_LT((points[1].cast<double>() - correction.T_map_odom * (at(0.2) * Vec3(0.0, 0.0, 1.0))).norm(), 1e-5);
}

TEST(PointMap, SessionsNumberTheirPointsAnew) {
  PointMap map{PointMapOptions()};
  map.begin_session();
  const KeyframePoints of_before{{{3, {0.0F, 0.0F, 1.0F}}}, line(2, 0.1F)};
  map.restore({0, std::make_shared<const KeyframePoints>(of_before)}, Sim3(at(0.5), 2.0));
  map.begin_session();
  map.add(keyframe(1, at(0.0), {{{3, {0.0F, 0.0F, 4.0F}}}, {}}));
  MapPoints points = map.points();
  ASSERT_EQ(points.sparse.size(), 2U);
  EXPECT_LT((points.sparse[0] - (at(0.5) * Vec3(0.0, 0.0, 2.0)).cast<float>()).norm(), 1e-6F);
  EXPECT_LT((points.sparse[1] - Eigen::Vector3f(0.0F, 0.0F, 4.0F)).norm(), 1e-6F);
  EXPECT_EQ(points.semi_dense.size(), 2U);
  MapCorrection correction;
  correction.changed = true;
  correction.valid_to_keyframe_id = 1;
  correction.keyframes = {{0, 0, 0, at(0.1)}, {1, 10, 0, at(0.0)}};
  map.apply(correction);
  points = map.points();
  EXPECT_LT((points.sparse[0] - (at(0.1) * Vec3(0.0, 0.0, 1.0)).cast<float>()).norm(), 1e-6F);
}

TEST(PointMap, PointsGrowWithTheScaleOfTheirKeyframe) {
  PointMap map{PointMapOptions()};
  for (int i = 0; i < 2; ++i) map.add(keyframe(i, at(0.1 * i), {{}, line(1, 0.1F)}));
  MapCorrection correction;
  correction.changed = true;
  correction.valid_to_keyframe_id = 1;
  correction.scale = 2.0;
  correction.keyframes = {{0, 0, 0, at(0.0), 1.0}, {1, 10, 0, at(0.2), 2.0}};
  map.apply(correction);
  correction.changed = false;
  correction.T_map_odom = SE3(Quaternion::Identity(), Vec3(0.0, 1.0, 0.0));  // it follows the camera
  map.apply(correction);
  map.add(keyframe(2, at(0.2), {{}, line(1, 0.1F)}));
  const Points points = map.points().semi_dense;
  ASSERT_EQ(points.size(), 3U);
  EXPECT_LT((points[0].cast<double>() - at(0.0) * Vec3(0.0, 0.0, 1.0)).norm(), 1e-5);
  EXPECT_LT((points[1].cast<double>() - at(0.2) * Vec3(0.0, 0.0, 2.0)).norm(), 1e-5);
  EXPECT_LT((points[2].cast<double>() - correction.T_map_odom * (at(0.2) * Vec3(0.0, 0.0, 2.0))).norm(), 1e-5);
}

TEST(PointMap, KeepsOnePointAVoxelAndNoneThatIsNotFinite) {
  PointMap map{PointMapOptions()};
  Points points = line(100, 0.001F);
  points.emplace_back(std::numeric_limits<float>::quiet_NaN(), 0.0F, 1.0F);
  points.emplace_back(std::numeric_limits<float>::infinity(), 0.0F, 1.0F);
  map.add(keyframe(0, SE3(), {{{1, {std::numeric_limits<float>::quiet_NaN(), 0.0F, 1.0F}}}, points}));
  const MapPoints kept = map.points();
  EXPECT_EQ(kept.semi_dense.size(), 5U);  // 0.1 m by 0.02 m
  EXPECT_TRUE(kept.sparse.empty());
  for (const Eigen::Vector3f& p : kept.semi_dense) EXPECT_TRUE(p.allFinite());
}

TEST(PointMap, StaysWithinItsBoundAndThinsTheOldestFirst) {
  PointMapOptions options;
  options.points_max = 1000;
  PointMap map(options);
  for (int i = 0; i < 10; ++i) map.add(keyframe(i, SE3(), {{}, line(100, 0.1F)}));
  EXPECT_EQ(map.size(), 1000U);
  map.add(keyframe(10, SE3(), {{}, line(100, 0.1F)}));
  EXPECT_EQ(map.size(), 1000U);
  for (int i = 11; i < 500; ++i) map.add(keyframe(i, SE3(), {{}, line(100, 0.1F)}));
  EXPECT_LE(map.size(), 1000U);
  EXPECT_EQ(map.points().semi_dense.size(), map.size());
  EXPECT_LT(map.keyframes(), 500U) << "of the oldest nothing is left";
}

TEST(PointMapOptions, RefusesWhatIsNotPositiveByName) {
  PointMapOptions options;
  EXPECT_TRUE(validate(options));
  options.voxel_m = 0.0;
  EXPECT_EQ(validate(options).message(), "parameter 'point_map.voxel_m' = '0' must be > 0");
  options = {};
  options.points_max = 0;
  EXPECT_FALSE(validate(options));
}

}  // namespace
}  // namespace semantic_topo_loop::core
