// Maps of robots that share some rooms of a house, or none.

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "pipeline/map_changes.h"
#include "pipeline/map_state.h"
#include "semantic_topo_loop/geometry/lie.h"
#include "support/package_config.h"
#include "support/simulated_run.h"
#include "tools/evaluation/trajectory_evaluation.h"
#include "tools/simulation/sequence.h"

namespace semantic_topo_loop::core {
namespace {

/// A robot that mapped some rooms of a house of five, with an odometry frame, a drift and a detector of its own.
struct Robot {
  SimulatedSequence sequence;
  std::shared_ptr<const MapState> map;
};

Robot make_robot(int seed, int first_room, int rooms, double duration_s) {
  SimulationOptions options;
  options.seed = seed;
  options.odometry_frame = "random";
  options.scene.seed = 1;
  options.scene.layout = "house";
  options.scene.desks = 5;
  options.trajectory.model = "robot";
  options.trajectory.first_desk = first_room;
  options.trajectory.desks = rooms;
  options.trajectory.lap_s = options.trajectory.duration_s = duration_s;
  options.trajectory.rate_hz = 10.0;
  options.drift.position_m = 0.5;
  options.drift.rotation_deg = 3.0;
  Robot robot{checked(simulate(options, camera_fr2(), coco())), nullptr};
  robot.map = testing::map_of(robot.sequence, 0, robot.sequence.odometry.size(), shared_coco());
  return robot;
}

/// The true poses and the map's of a robot's keyframes, of all from `begin` to before `end`.
double ate_m(const MapState& map, std::int64_t begin, std::int64_t end, const SimulatedSequence& sequence) {
  StampedPoses poses;
  for (const KeyframePose& pose : map.keyframe_poses()) {
    if (pose.keyframe_id >= begin && pose.keyframe_id < end) poses.push_back({pose.stamp_ns, pose.T_map_camera});
  }
  return checked(evaluate_trajectory(poses, sequence.truth)).absolute_m.rmse;
}

/// The true object that most of a landmark's boxes from a robot show; -1: none.
/// @param first_frame of the robot's session, first_keyframe and end_keyframe too
int shown(const MappedLandmark& landmark, const SimulatedSequence& sequence, std::int64_t first_frame,
          std::int64_t first_keyframe, std::int64_t end_keyframe) {
  std::map<int, int> votes;
  for (const Observation& observation : landmark.observations) {
    if (observation.keyframe_id < first_keyframe || observation.keyframe_id >= end_keyframe) continue;
    const auto frame = static_cast<std::size_t>(observation.frame_id - first_frame);
    double best = 0.0;
    int object = -1;
    for (const SimulatedDetection& d : sequence.detections.at(frame)) {
      const double overlap = iou(sequence.camera.undistort(d.detection.box), observation.view.box);
      if (overlap <= best) continue;
      best = overlap;
      object = d.object;
    }
    ++votes[object];
  }
  const auto most =
      std::max_element(votes.begin(), votes.end(), [](const auto& a, const auto& b) { return a.second < b.second; });
  return most == votes.end() ? -1 : most->first;
}

class MapMerging : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    first_ = new Robot(make_robot(11, 1, 3, 80.0));
    second_ = new Robot(make_robot(12, 2, 3, 80.0));
    apart_ = new Robot(make_robot(13, 4, 2, 60.0));
  }
  static void TearDownTestSuite() {
    for (const Robot* robot : {first_, second_, apart_}) delete robot;
  }
  static const Robot *first_, *second_, *apart_;
};
const Robot *MapMerging::first_ = nullptr, *MapMerging::second_ = nullptr, *MapMerging::apart_ = nullptr;

TEST_F(MapMerging, RobotsThatShareRoomsMakeOneMap) {
  MapState a = *first_->map, b = *second_->map;
  const auto points = std::make_shared<const KeyframePoints>(KeyframePoints{{}, {{0.0F, 0.0F, 1.0F}}});
  for (MapState* map : {&a, &b}) map->points = {{1, points}};
  const MergedMaps merged = merge_maps(a, b, Options(), shared_coco());
  ASSERT_EQ(merged.joined.message(), "");
  const MapState& map = *merged.map;
  EXPECT_EQ(check(map).message(), "");
  ASSERT_EQ(map.graph.sessions.size(), 2U);
  const std::int64_t second = map.graph.sessions[1].first_keyframe_id, end = map.graph.next_keyframe_id();
  EXPECT_LE(ate_m(map, 0, second, first_->sequence), 1.5 * ate_m(a, 0, second, first_->sequence));
  EXPECT_LE(ate_m(map, second, end, second_->sequence), 1.5 * ate_m(b, 0, end, second_->sequence));
  ASSERT_EQ(map.points.size(), 2U);
  EXPECT_EQ(map.points[0].keyframe_id, 1);
  EXPECT_EQ(map.points[1].keyframe_id, second + 1);
  int common = 0;
  for (const MappedLandmark& landmark : map.objects.landmarks) {
    if (landmark.state.state != LandmarkState::kConfirmed) continue;
    const int of_first = shown(landmark, first_->sequence, 0, 0, second);
    const int of_second = shown(landmark, second_->sequence, a.graph.next_frame_id, second, end);
    if (of_first < 0 || of_second < 0) continue;
    EXPECT_EQ(of_first, of_second) << "object " << landmark.state.id;
    ++common;
  }
  EXPECT_GE(common, 20) << "of two rooms with some twenty objects each";
  EXPECT_GE(map_agreement(map, second).ratio(), 0.7);
}

TEST_F(MapMerging, RobotsThatShareNoRoomStayApart) {
  EXPECT_NE(merge_maps(*first_->map, *apart_->map, Options(), shared_coco()).joined.message(), "");
  EXPECT_NE(merge_maps(*apart_->map, *first_->map, Options(), shared_coco()).joined.message(), "");
}

/// Other rooms that a false loop puts on top of each other contradict it.
TEST_F(MapMerging, RoomsInTheSamePlaceThatDifferDoNotAgree) {
  MapState map = *first_->map;
  const std::int64_t second = map.graph.next_keyframe_id();
  const SE3 T_odom_world =
      first_->sequence.odometry[0].T_world_camera * first_->sequence.truth[0].T_world_camera.inverse();
  const SE3 T_world_odom_apart =
      apart_->sequence.truth[0].T_world_camera * apart_->sequence.odometry[0].T_world_camera.inverse();
  const std::vector<Desk>& desks = first_->sequence.scene.desks;
  const SE3 T_wrong_right(Quaternion::Identity(), desks[0].T_world_desk.t - desks[3].T_world_desk.t);
  map.append(*apart_->map);
  const SE3 T_beside_odom = map.graph.keyframes[static_cast<std::size_t>(second)].pose.T_map_camera *
                            apart_->map->graph.keyframes[0].pose.T_map_camera.inverse();
  const SE3 T_new_old = T_odom_world * T_wrong_right * T_world_odom_apart * T_beside_odom.inverse();
  for (GraphKeyframe& keyframe : map.graph.keyframes) {
    if (keyframe.pose.keyframe_id >= second) keyframe.pose.T_map_camera = T_new_old * keyframe.pose.T_map_camera;
  }
  for (MappedLandmark& landmark : map.objects.landmarks) {
    if (!landmark.state.ellipsoid || landmark.state.anchor_keyframe_id < second) continue;
    SE3& T_map_quadric = landmark.state.ellipsoid->T_world_quadric;
    T_map_quadric = T_new_old * T_map_quadric;
    landmark.seen_from.turn(T_new_old.q);
  }
  const MapAgreement agreement = map_agreement(map, second);
  EXPECT_EQ(agreement.ratio(), 0.0);
  EXPECT_GE(agreement.only_first + agreement.only_second, 10);
}

}  // namespace
}  // namespace semantic_topo_loop::core
