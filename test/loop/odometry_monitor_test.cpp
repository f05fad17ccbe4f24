#include "loop/graph/odometry_monitor.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "loop/graph/submap_index.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "support/synthetic_desk.h"

namespace semantic_topo_loop::core {
namespace {

using testing::uniform;

/// Feeds a sweep around a desk to a monitor whose reference is the submap of the last window.
struct Watch {
  double drift_deg_s = 0.0;  ///< the odometry tilts
  SE3 jump;                  ///< of the odometry at 14 s
  std::optional<double> drift_rad_s;
  std::vector<double> jumps_s;

  void run() {
    const LoopOptions options;
    const auto desk = testing::random_desk(3, 12);
    ObservationWindow window(8.0, options.frame_interval_s, LabelTable(*testing::desk_classes()));
    UpEstimator up(options.up_window_s);
    const LocalMapBuilder map_builder(options);
    FrameBuilder builder(KeyframeOptions(), testing::desk_camera());
    OdometryMonitor monitor;
    std::mt19937_64 random(5);
    for (std::int64_t k = 0; k < 200; ++k) {
      const double time_s = 0.1 * static_cast<double>(k);
      const SE3 pose = testing::desk_pose({{0.0, 20.0, 0.0, 120.0}}, time_s);
      PoseSample sample;
      sample.stamp_ns = k * 100'000'000;
      const SE3 turn(so3_exp(Vec3(radians(drift_deg_s * time_s), 0.0, 0.0)), Vec3::Zero());
      sample.T_odom_camera = (time_s < 14.0 ? SE3() : jump) * turn * pose;
      const auto frame = builder.build(sample, nullptr);
      window.push(*frame, testing::observe(desk, *frame, pose, 0, random));
      up.push(*frame);
      if (monitor.push(window.frames().back())) {
        jumps_s.push_back(time_s);
        window.clear();
      }
      const auto map = k % 3 == 0 ? map_builder.build(window.frames(), LandmarkRedirects(), up) : std::nullopt;
      if (map) monitor.set_reference(*map);
    }
    drift_rad_s = monitor.drift_rad_s();
  }
};

TEST(OdometryMonitor, MeasuresDrift) {
  Watch good, poor;
  poor.drift_deg_s = 0.6;
  good.run();
  poor.run();
  ASSERT_TRUE(good.drift_rad_s && poor.drift_rad_s);
  EXPECT_TRUE(good.jumps_s.empty());
  EXPECT_TRUE(poor.jumps_s.empty());
  EXPECT_LT(*good.drift_rad_s, 0.002);
  EXPECT_GT(*poor.drift_rad_s, 2.0 * *good.drift_rad_s);
}

TEST(OdometryMonitor, NoticesAJump) {
  Watch watch;
  watch.jump = SE3(so3_exp(Vec3(0.0, 0.0, radians(8.0))), Vec3(0.1, 0.0, 0.0));
  watch.run();
  ASSERT_EQ(watch.jumps_s.size(), 1u);
  EXPECT_NEAR(watch.jumps_s.front(), 14.2, 0.3);
}

TEST(OdometryMonitor, SaysNothingWithoutAReference) {
  OdometryMonitor monitor;
  EXPECT_FALSE(monitor.push(ObservedFrame()));
  EXPECT_FALSE(monitor.drift_rad_s().has_value());
}

std::vector<LabelledPoint> random_points(std::mt19937_64& random, int count) {
  std::vector<LabelledPoint> points;
  for (int i = 0; i < count; ++i) {
    LabelledPoint point;
    point.position = Vec3(uniform(random, -1, 1), uniform(random, -1, 1), uniform(random, 0, 0.5));
    point.label = static_cast<int>(uniform(random, 0, 8));
    point.size = 0.1;
    points.push_back(point);
  }
  return points;
}

TEST(SubmapIndex, FindsTheSubmapThatSharesObjects) {
  std::mt19937_64 random(1);
  SubmapIndexOptions options;
  options.max_candidates = 5;
  SubmapIndex index(options);
  std::vector<std::vector<LabelledPoint>> maps;
  for (int i = 0; i < 200; ++i) {
    maps.push_back(random_points(random, 12));
    index.insert(maps.back());
  }
  ASSERT_EQ(index.size(), 200);
  const SE3 T_query_map(so3_exp(Vec3(0.4, -1.0, 2.0)), Vec3(3.0, 1.0, -2.0));
  for (int i = 0; i < 200; i += 10) {
    std::vector<LabelledPoint> query(maps[static_cast<std::size_t>(i)].begin(),
                                     maps[static_cast<std::size_t>(i)].begin() + 8);
    for (LabelledPoint& point : query) point.position = T_query_map * point.position;
    const std::vector<int> candidates = index.query(query, 200);
    EXPECT_LE(candidates.size(), 5u);
    EXPECT_TRUE(std::is_sorted(candidates.begin(), candidates.end()));
    EXPECT_TRUE(std::count(candidates.begin(), candidates.end(), i) == 1) << i;
    const std::vector<int> before = index.query(query, i);
    EXPECT_TRUE(before.empty() || before.back() < i) << "submaps from `end` on are left out";
  }
}

TEST(SubmapIndex, BadPointsAreLeftOut) {
  std::mt19937_64 random(2);
  SubmapIndex index{SubmapIndexOptions()};
  std::vector<LabelledPoint> points = random_points(random, 8);
  points[0].position.x() = std::nan("");
  points[1].label = -1;
  points[2].position = points[3].position;
  points[4].position.y() = 1e300;
  index.insert(points);
  index.insert({});
  EXPECT_EQ(index.query({}, 2).size(), 0u);
  for (const int candidate : index.query(points, 2)) EXPECT_EQ(candidate, 0);
}

}  // namespace
}  // namespace semantic_topo_loop::core
