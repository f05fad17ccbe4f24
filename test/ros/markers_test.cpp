#include "ros/markers.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "ros/conversions.h"
#include "ros/map_view.h"
#include "semantic_topo_loop/LoopClosure.h"
#include "semantic_topo_loop/geometry/lie.h"

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
  EXPECT_EQ(follower.follow(make_update(4, 5, {})).size(), 1u);
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
  EXPECT_EQ(follower.follow(make_update(1, 2, {})).size(), 1u);
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

core::AssociationFrame seen(std::int64_t landmark_id) {
  core::AssociationFrame frame;
  frame.associations.emplace_back();
  frame.associations.back().landmark_id = landmark_id;
  return frame;
}

using visualization_msgs::Marker;

core::Landmark make_landmark(std::int64_t id, int class_id, core::LandmarkState state, const core::Vec3& center) {
  core::Landmark landmark;
  landmark.id = id;
  landmark.class_id = class_id;
  landmark.state = state;
  landmark.quality = 0.5;
  landmark.ellipsoid = core::Ellipsoid{core::SE3(core::Quaternion::Identity(), center), {0.1, 0.2, 0.3}};
  return landmark;
}

TEST(MapView, FollowsMergesThatAreTakenBack) {
  const auto a = make_landmark(1, 62, core::LandmarkState::kConfirmed, {0.0, 0.0, 1.0});
  const auto b = make_landmark(2, 62, core::LandmarkState::kConfirmed, {0.1, 0.0, 1.0});
  MapView view;
  core::MapUpdate update;
  update.changed = {a, b};
  view.apply(update);
  view.set_view(seen(2));
  update = {};
  update.merged = {{2, 1}};
  view.apply(update);
  ASSERT_EQ(view.objects_in_view().size(), 1u);
  EXPECT_EQ(view.objects_in_view()[0]->id, 1) << "who was merged is shown as its survivor";
  EXPECT_EQ(view.landmarks().count(2), 0u);
  update = {};
  update.unmerged = {{2, 1}};
  update.changed = {b};
  view.apply(update);
  ASSERT_EQ(view.objects_in_view().size(), 1u);
  EXPECT_EQ(view.objects_in_view()[0]->id, 2);
  // The other way about: neither a ring nor a stale redirect is left.
  update = {};
  update.merged = {{1, 2}};
  view.apply(update);
  ASSERT_EQ(view.objects_in_view().size(), 1u);
  EXPECT_EQ(view.objects_in_view()[0]->id, 2);
  view.set_view(seen(1));
  ASSERT_EQ(view.objects_in_view().size(), 1u);
  EXPECT_EQ(view.objects_in_view()[0]->id, 2);
}

TEST(MapView, EndsWhereBadUpdatesMakeARing) {
  MapView view;
  core::MapUpdate update;
  update.merged = {{1, 2}, {2, 3}, {3, 1}};
  view.apply(update);
  view.set_view(seen(1));
  EXPECT_TRUE(view.objects_in_view().empty());
}

core::KeyframePose pose_of(std::int64_t keyframe_id, double x) {
  core::KeyframePose pose;
  pose.keyframe_id = keyframe_id;
  pose.T_map_camera.t.x() = x;
  return pose;
}

TEST(MapView, ACorrectionMaySayOnlyWhatHasChanged) {
  MapView view;
  for (const std::int64_t id : {0, 1, 2}) {
    view.add_keyframe(id, core::SE3(core::Quaternion::Identity(), {static_cast<double>(id), 0.0, 0.0}));
  }
  std::vector<core::LoopClosure> loops(2);
  loops[0].query_keyframe_id = 2;
  loops[0].match_keyframe_id = 0;
  loops[1].query_keyframe_id = 2;
  loops[1].match_keyframe_id = 1;
  for (core::LoopClosure& loop : loops) loop.accepted = true;
  view.add_loops(loops);
  core::MapCorrection correction;
  correction.changed = true;
  correction.valid_to_keyframe_id = 1;
  correction.T_map_odom.t.y() = 1.0;
  correction.keyframes = {pose_of(0, 0.5), pose_of(1, 1.5)};
  correction.loops = {{0, 2, 0, false}, {1, 2, 1, true}};
  view.apply(correction);
  EXPECT_EQ(view.keyframes().at(2).T_map_camera.t, core::Vec3(2.0, 1.0, 0.0)) << "newer than the solution";
  correction.valid_to_keyframe_id = 2;
  correction.keyframes = {pose_of(1, 1.25), pose_of(2, 2.25)};
  correction.loops = {{1, 2, 1, false}};
  view.apply(correction);
  EXPECT_EQ(view.keyframes().at(0).T_map_camera.t.x(), 0.5) << "as it was";
  EXPECT_EQ(view.keyframes().at(1).T_map_camera.t.x(), 1.25);
  EXPECT_EQ(view.keyframes().at(2).T_map_camera.t.x(), 2.25);
  ASSERT_EQ(view.loops().size(), 2u);
  for (const auto& [loop, accepted] : view.loops()) EXPECT_FALSE(accepted.kept) << loop.second;
}

TEST(MapView, ASessionBeginsBesideTheEarlierMapWhichStays) {
  MapView view;
  view.add_earlier_keyframe(0, pose_of(0, 3.0).T_map_camera);
  core::MapUpdate update;
  update.T_map_odom.t.y() = 1e6;  // no frame has told where the odometry is
  view.apply(update);
  view.add_keyframe(1, pose_of(1, 100.0).T_map_camera);
  update.T_map_odom.t = core::Vec3(-77.0, 0.0, 0.0);
  view.apply(update);
  EXPECT_EQ(view.keyframes().at(0).T_map_camera.t, core::Vec3(3.0, 0.0, 0.0));
  EXPECT_EQ(view.keyframes().at(1).T_map_camera.t, core::Vec3(23.0, 0.0, 0.0));
}

/// A loop from outside joins the keyframes that an own one joins.
TEST(MapView, ShowsLoopsFromOutsideBesideTheirOwn) {
  MapView view;
  for (const std::int64_t id : {0, 1}) {
    view.add_keyframe(id, core::SE3(core::Quaternion::Identity(), {static_cast<double>(id), 0.0, 0.0}));
  }
  std::vector<core::LoopClosure> own(1);
  own[0].query_keyframe_id = 1;
  own[0].match_keyframe_id = 0;
  own[0].accepted = true;
  view.add_loops(own);
  core::MapCorrection correction;
  correction.changed = true;
  correction.loops = {{0, 1, 0, true}, {1, 1, 0, false, "it is wrong", true}};
  view.apply(correction);
  EXPECT_TRUE(view.loops().at({1, 0}).kept) << "the verdict is another one's";
  const auto lines = make_loop_markers(view, std_msgs::Header(), {});
  ASSERT_EQ(lines->markers.size(), 3u);
  for (const std::size_t i : {1u, 2u}) EXPECT_EQ(lines->markers[i].points.size(), 2u);
  EXPECT_GT(lines->markers[2].color.r, lines->markers[2].color.g) << "the one from outside";
  const auto map = make_loop_map(view, std_msgs::Header(), 7);
  ASSERT_EQ(map->loops.size(), 2u);
  EXPECT_TRUE(map->loops[0].kept);
  EXPECT_FALSE(map->loops[1].kept);
  EXPECT_EQ(map->loops[1].reason, LoopClosure::REASON_ACCEPTED);
  EXPECT_TRUE(map->loops[1].objects.empty());
}

/// Two confirmed objects, a candidate, a retired one and one without an ellipsoid.
MapView make_view() {
  core::MapUpdate update;
  update.changed = {make_landmark(1, 62, core::LandmarkState::kConfirmed, {0.0, 0.0, 1.0}),
                    make_landmark(2, 66, core::LandmarkState::kConfirmed, {1.0, 0.0, 1.0}),
                    make_landmark(3, 41, core::LandmarkState::kCandidate, {2.0, 0.0, 1.0}),
                    make_landmark(4, 41, core::LandmarkState::kRetired, {3.0, 0.0, 1.0}),
                    make_landmark(5, 41, core::LandmarkState::kConfirmed, {4.0, 0.0, 1.0})};
  update.changed.back().ellipsoid.reset();
  MapView view;
  view.apply(update);
  return view;
}

core::AssociationFrame make_associations(const std::vector<std::int64_t>& landmark_ids) {
  core::AssociationFrame frame;
  for (const std::int64_t id : landmark_ids) {
    frame.associations.emplace_back();
    frame.associations.back().landmark_id = id;
  }
  return frame;
}

std_msgs::Header map_header() {
  std_msgs::Header header;
  header.frame_id = "map";
  return header;
}

std::size_t count_layer(const visualization_msgs::MarkerArray& array, const std::string& layer) {
  return static_cast<std::size_t>(std::count_if(array.markers.begin(), array.markers.end(), [&layer](const Marker& m) {
    return m.ns == layer && m.action == Marker::ADD;
  }));
}

TEST(Markers, EveryArrayBeginsWithDeleteAllInTheMapFrame) {
  const MapView view = make_view();
  const core::ClassTable classes;
  for (const auto& array :
       {make_quadric_markers(view, map_header()), make_label_markers(view, map_header(), classes, {}),
        make_topology_markers(view, map_header(), {}), make_loop_markers(view, map_header(), {}),
        make_keyframe_markers(view, map_header(), {})}) {
    ASSERT_FALSE(array->markers.empty());
    EXPECT_EQ(array->markers.front().action, Marker::DELETEALL);
    for (const Marker& marker : array->markers) EXPECT_EQ(marker.header.frame_id, "map");
  }
}

TEST(Markers, QuadricsHaveTheirAxesIdsAndStates) {
  const auto array = make_quadric_markers(make_view(), map_header());
  EXPECT_EQ(count_layer(*array, "quadrics"), 2u);
  EXPECT_EQ(count_layer(*array, "candidates"), 1u);
  const Marker& first = array->markers[1];
  EXPECT_EQ(first.id, 1);
  EXPECT_EQ(first.type, Marker::SPHERE);
  EXPECT_DOUBLE_EQ(first.scale.x, 0.2);
  EXPECT_DOUBLE_EQ(first.scale.y, 0.4);
  EXPECT_DOUBLE_EQ(first.scale.z, 0.6);
  EXPECT_LT(array->markers[3].color.a, first.color.a);
}

TEST(Markers, LabelsStandAboveTheObjectAlongTheCamerasUp) {
  MapView view = make_view();
  const core::ClassTable classes;
  // Without a keyframe, up is -y; one camera that lies on its side makes it x.
  auto array = make_label_markers(view, map_header(), classes, {});
  ASSERT_EQ(count_layer(*array, "labels"), 2u);
  EXPECT_LT(array->markers[1].pose.position.y, -0.2);
  EXPECT_EQ(array->markers[1].text, "class_62");
  core::Mat3 R;
  R << 0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0;
  view.add_keyframe(0, core::SE3(R, core::Vec3::Zero()));
  array = make_label_markers(view, map_header(), classes, {});
  EXPECT_GT(array->markers[1].pose.position.x, 0.1);
  EXPECT_NEAR(array->markers[1].pose.position.y, 0.0, 1e-12);
}

TEST(Markers, TopologyJoinsTheObjectsInViewThroughMerges) {
  MapView view = make_view();
  core::MapUpdate merge;
  merge.merged = {{3, 2}};
  view.apply(merge);
  view.set_view(make_associations({1, 3, -1, 4, 99}));
  const auto array = make_topology_markers(view, map_header(), {});
  ASSERT_EQ(array->markers.size(), 2u);
  ASSERT_EQ(array->markers[1].points.size(), 2u);
  EXPECT_EQ(array->markers[1].points[0].x, 0.0);
  EXPECT_EQ(array->markers[1].points[1].x, 1.0);
}

TEST(Markers, LoopsAreGreenUntilTheOptimiserRejectsThem) {
  MapView view;
  for (int i = 0; i < 3; ++i) view.add_keyframe(i, core::SE3(core::Quaternion::Identity(), core::Vec3(i, 0.0, 0.0)));
  std::vector<core::LoopClosure> loops(2);
  core::LoopClosure &accepted = loops[0], &rejected = loops[1];
  accepted.query_keyframe_id = 2;
  accepted.match_keyframe_id = 0;
  accepted.accepted = true;
  rejected.query_keyframe_id = 1;
  rejected.match_keyframe_id = 0;
  view.add_loops(loops);
  auto array = make_loop_markers(view, map_header(), {});
  ASSERT_EQ(array->markers.size(), 2u);
  EXPECT_EQ(array->markers[1].points.size(), 2u);
  EXPECT_GT(array->markers[1].color.g, array->markers[1].color.r);

  core::MapCorrection correction;
  correction.changed = true;
  correction.loops = {{0, 2, 0, false}};
  view.apply(correction);
  array = make_loop_markers(view, map_header(), {});
  ASSERT_EQ(array->markers.size(), 2u);
  EXPECT_GT(array->markers[1].color.r, array->markers[1].color.g);
}

TEST(LoopMap, HasAcceptedLoopsWithTheirObjectsAndRefusedOnesWithTheirReason) {
  MapView view = make_view();
  core::MapUpdate merge;
  merge.merged = {{3, 2}};
  view.apply(merge);
  for (int i = 0; i < 4; ++i) view.add_keyframe(i, core::SE3(core::Quaternion::Identity(), core::Vec3(i, 0.0, 0.0)));
  std::vector<core::LoopClosure> loops(4);
  for (std::size_t i = 0; i < loops.size(); ++i) {
    loops[i].query_keyframe_id = 3;
    loops[i].match_keyframe_id = static_cast<std::int64_t>(i);
    loops[i].reason = core::LoopReason::kResidual;
  }
  loops[1].accepted = true;
  loops[1].reason = core::LoopReason::kAccepted;
  loops[1].matches = {{1, 1}, {3, 2}, {4, 4}, {99, 99}};  // of these one was merged, one is retired, one is not there
  loops[2].query_keyframe_id = 9;                         // no such keyframe
  loops[3].match_keyframe_id = 1;                         // the same pair as was accepted
  view.add_loops(loops);
  const auto map = make_loop_map(view, map_header(), 7);
  EXPECT_EQ(map->header.frame_id, "map");
  EXPECT_EQ(map->session_id, 7u);
  ASSERT_EQ(map->loops.size(), 2u);
  const LoopPlace &accepted = map->loops[0], &refused = map->loops[1];
  EXPECT_EQ(accepted.match_keyframe_id, 1);
  EXPECT_EQ(accepted.reason, LoopClosure::REASON_ACCEPTED);
  EXPECT_TRUE(accepted.kept);
  EXPECT_EQ(accepted.query.x, 3.0);
  EXPECT_EQ(accepted.match.x, 1.0);
  EXPECT_EQ(accepted.landmark_ids, (std::vector<std::int64_t>{1, 2}));
  ASSERT_EQ(accepted.objects.size(), 2u);
  EXPECT_EQ(accepted.objects[1].x, 1.0);
  EXPECT_EQ(refused.match_keyframe_id, 0);
  EXPECT_EQ(refused.reason, LoopClosure::REASON_RESIDUAL);
  EXPECT_FALSE(refused.kept);
  EXPECT_TRUE(refused.objects.empty());
}

TEST(LoopMap, HoldsTheLastOfManyRefusedCandidates) {
  MapView view;
  for (std::int64_t id = 0; id < 5000; ++id) {
    core::LoopClosure loop;
    loop.query_keyframe_id = id;
    loop.match_keyframe_id = 0;
    view.add_loops({loop});
  }
  EXPECT_EQ(view.refused_loops().size(), 2000u);
  EXPECT_EQ(view.refused_loops().rbegin()->first.first, 4999);
}

TEST(MapView, CorrectionMovesKeyframesAndComposesTheLaterOnes) {
  MapView view;
  view.add_keyframe(0, core::SE3());
  view.add_keyframe(1, core::SE3(core::Quaternion::Identity(), {1.0, 0.0, 0.0}));
  core::MapCorrection correction;
  correction.changed = true;
  correction.T_map_odom.t = core::Vec3(0.0, 5.0, 0.0);
  correction.keyframes = {{0, 0, 0, core::SE3(core::Quaternion::Identity(), {0.0, 0.0, 7.0})}};
  view.apply(correction);
  EXPECT_EQ(view.keyframes().at(0).T_map_camera.t, core::Vec3(0.0, 0.0, 7.0));
  EXPECT_EQ(view.keyframes().at(1).T_map_camera.t, core::Vec3(1.0, 5.0, 0.0));
  view.add_keyframe(2, core::SE3());
  EXPECT_EQ(view.keyframes().at(2).T_map_camera.t, core::Vec3(0.0, 5.0, 0.0));
  core::Frame frame;
  frame.camera = {100.0, 100.0, 50.0, 50.0, 100, 100, {}};
  frame.T_odom_camera.t = core::Vec3(3.0, 0.0, 0.0);
  view.set_frame(frame);
  const Marker current = make_keyframe_markers(view, map_header(), {})->markers.back();
  EXPECT_EQ(current.points.front().x, 3.0);
  EXPECT_EQ(current.points.front().y, 5.0);
}

TEST(MapView, UprightIsVerticalHoweverTheWorldLies) {
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  for (int i = 0; i < 20; ++i) {
    // Level cameras that look 40 deg down, turning about the vertical of a world in any attitude.
    const core::Mat3 R_map_level =
        core::so3_exp(3.0 * core::Vec3(uniform(random), uniform(random), uniform(random))).toRotationMatrix();
    MapView view;
    for (int k = 0; k < 8; ++k) {
      core::Mat3 R_level_optical;
      R_level_optical << 0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0;
      const core::Mat3 R_level_camera = core::so3_exp({0.0, 0.0, 0.2 * k}).toRotationMatrix() * R_level_optical *
                                        core::so3_exp({-core::radians(40.0), 0.0, 0.0}).toRotationMatrix();
      view.add_keyframe(k, core::SE3(core::Mat3(R_map_level * R_level_camera), core::Vec3(k, 2.0, 3.0)));
    }
    const std::optional<core::SE3> T_map_upright = view.T_map_upright();
    ASSERT_TRUE(T_map_upright);
    EXPECT_GT(T_map_upright->rotation().col(2).dot(R_map_level.col(2)), std::cos(core::radians(5.0)));
    EXPECT_GT(T_map_upright->rotation().col(0).dot(R_map_level.col(0)), std::cos(core::radians(5.0)));
    EXPECT_EQ(T_map_upright->t, core::Vec3(0.0, 2.0, 3.0));
  }
}

TEST(MapView, NothingIsUprightWithoutAKeyframe) { EXPECT_FALSE(MapView().T_map_upright()); }

TEST(ClassColor, DiffersBetweenTheObjectsOfADesk) {
  const std::vector<int> desk = {39, 41, 56, 58, 62, 63, 64, 65, 66, 67, 73, 77};
  for (std::size_t i = 0; i < desk.size(); ++i) {
    const auto a = class_color(desk[i], 1.0);
    EXPECT_GE(std::max({a.r, a.g, a.b}), 0.7f) << desk[i];
    for (std::size_t j = 0; j < i; ++j) {
      const auto b = class_color(desk[j], 1.0);
      EXPECT_GT(std::abs(a.r - b.r) + std::abs(a.g - b.g) + std::abs(a.b - b.b), 0.15f) << desk[i] << ' ' << desk[j];
    }
  }
}

TEST(Markers, MessagesOfALongRunStayBounded) {
  EXPECT_EQ(thinning(0, 500), 1u);
  EXPECT_EQ(thinning(500, 500), 1u);
  EXPECT_EQ(thinning(501, 500), 2u);
  EXPECT_EQ(thinning(86400, 500), 256u);
  MapView view;
  core::Frame frame;
  frame.camera.fx = frame.camera.fy = 500.0;
  frame.camera.width = 640;
  frame.camera.height = 480;
  view.set_frame(frame);
  for (std::int64_t id = 0; id < 5000; ++id) {
    view.add_keyframe(id, core::SE3(core::Quaternion::Identity(), {static_cast<double>(id), 0.0, 0.0}));
  }
  const auto array = make_keyframe_markers(view, {}, {});
  ASSERT_EQ(array->markers.size(), 3u);
  constexpr std::size_t kPointsOfOne = 16;
  EXPECT_LE(array->markers[1].points.size(), 500 * kPointsOfOne);
  EXPECT_GT(array->markers[1].points.size(), 200 * kPointsOfOne);
}

}  // namespace
}  // namespace semantic_topo_loop
