#include "semantic_topo_loop/ros/conversions.h"

#include <gtest/gtest.h>
#include <ros/serialization.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <random>

#include "ros/conversions_points.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop {
namespace {

/// Doubles of every size, and quaternions that are not quite unit: what a conversion must not touch.
class Random {
 public:
  explicit Random(std::uint64_t seed) : engine_(seed) {}
  double number() {
    const double mantissa = static_cast<double>(engine_() >> 11) * 0x1p-53 - 0.5;
    return std::ldexp(mantissa, static_cast<int>(engine_() % 60) - 30);
  }
  std::int64_t integer() { return static_cast<std::int64_t>(engine_() % 1000000007ull) - 1; }
  int small() { return static_cast<int>(engine_() % 1000); }
  bool flag() { return engine_() % 2 == 0; }
  core::Vec3 vector() { return {number(), number(), number()}; }
  core::SE3 pose() { return {core::Quaternion(number(), number(), number(), number()), vector()}; }
  core::Box box() { return {number(), number(), number(), number()}; }
  template <class Matrix>
  Matrix matrix() {
    return Matrix::NullaryExpr([this](Eigen::Index, Eigen::Index) { return number(); });
  }

 private:
  std::mt19937_64 engine_;
};

::testing::AssertionResult same_bits(double a, double b) {
  if (std::memcmp(&a, &b, sizeof a) == 0) return ::testing::AssertionSuccess();
  return ::testing::AssertionFailure() << a << " and " << b << " differ by " << a - b;
}

template <class Derived>
::testing::AssertionResult same_matrix(const Eigen::MatrixBase<Derived>& a, const Eigen::MatrixBase<Derived>& b) {
  for (Eigen::Index row = 0; row < a.rows(); ++row) {
    for (Eigen::Index col = 0; col < a.cols(); ++col) {
      if (!same_bits(a(row, col), b(row, col)))
        return same_bits(a(row, col), b(row, col)) << " at " << row << ',' << col;
    }
  }
  return ::testing::AssertionSuccess();
}

void expect_same(const core::SE3& a, const core::SE3& b) {
  EXPECT_TRUE(same_matrix(a.t, b.t));
  EXPECT_TRUE(same_matrix(a.q.coeffs(), b.q.coeffs()));
}

void expect_same(const core::Box& a, const core::Box& b) { EXPECT_TRUE(same_matrix(a.edges(), b.edges())); }

void expect_same(const core::Landmark& a, const core::Landmark& b) {
  EXPECT_EQ(a.id, b.id);
  EXPECT_EQ(a.class_id, b.class_id);
  EXPECT_EQ(a.state, b.state);
  ASSERT_EQ(a.ellipsoid.has_value(), b.ellipsoid.has_value());
  if (a.ellipsoid) {
    expect_same(a.ellipsoid->T_world_quadric, b.ellipsoid->T_world_quadric);
    EXPECT_TRUE(same_matrix(a.ellipsoid->semi_axes, b.ellipsoid->semi_axes));
  }
  EXPECT_TRUE(same_matrix(a.center_covariance, b.center_covariance));
  EXPECT_EQ(a.anchor_keyframe_id, b.anchor_keyframe_id);
  EXPECT_EQ(a.observations, b.observations);
  EXPECT_TRUE(same_bits(a.baseline_deg, b.baseline_deg));
  EXPECT_TRUE(same_bits(a.mean_iou, b.mean_iou));
  EXPECT_TRUE(same_bits(a.quality, b.quality));
}

/// As a message looks after a trip between two processes.
template <class Message>
Message over_the_wire(const Message& message) {
  const ros::SerializedMessage bytes = ros::serialization::serializeMessage(message);
  ros::SerializedMessage payload = bytes;
  Message received;
  ros::serialization::IStream stream(payload.message_start, static_cast<std::uint32_t>(payload.num_bytes - 4));
  ros::serialization::deserialize(stream, received);
  return received;
}

core::Landmark random_landmark(Random* random) {
  core::Landmark landmark;
  landmark.id = random->integer();
  landmark.class_id = random->small();
  landmark.state = static_cast<core::LandmarkState>(random->small() % 3);
  if (random->flag()) landmark.ellipsoid = core::Ellipsoid{random->pose(), random->vector()};
  landmark.center_covariance = random->matrix<core::Mat3>();
  landmark.anchor_keyframe_id = random->integer();
  landmark.observations = random->small();
  landmark.baseline_deg = random->number();
  landmark.mean_iou = random->number();
  landmark.quality = random->number();
  return landmark;
}

core::LoopClosure random_loop(Random* random) {
  core::LoopClosure loop;
  for (std::int64_t* id :
       {&loop.query_keyframe_id, &loop.match_keyframe_id, &loop.query_frame, &loop.match_frame, &loop.query_stamp_ns,
        &loop.match_stamp_ns, &loop.query_begin, &loop.query_end, &loop.match_begin, &loop.match_end}) {
    *id = random->integer();
  }
  loop.accepted = random->flag();
  loop.reason = static_cast<core::LoopReason>(random->small() % 14);
  for (double* value : {&loop.score, &loop.second_score, &loop.rms_m, &loop.spread_m, &loop.tilt_deg,
                        &loop.reprojection_ratio, &loop.explained_share, &loop.refine_residual, &loop.refine_shift_m,
                        &loop.refine_shift_deg, &loop.sigma_m, &loop.sigma_deg}) {
    *value = random->number();
  }
  loop.reprojected_objects = random->small();
  if (random->flag()) loop.T_earlier_match = random->pose();
  loop.inliers = random->small();
  loop.labels = random->small();
  loop.T_match_query = random->pose();
  loop.covariance = random->matrix<core::Mat6>();
  loop.scale = random->number();
  loop.scale_covariance = random->matrix<core::Mat7>().col(2);
  loop.matches = {{random->integer(), random->integer()}, {random->integer(), random->integer()}};
  return loop;
}

TEST(Time, KeepsEveryNanosecond) {
  for (const std::int64_t stamp_ns : {std::int64_t{0}, std::int64_t{1}, std::int64_t{999999999},
                                      std::int64_t{1311868164363181001}, std::int64_t{4294967295999999999}}) {
    EXPECT_EQ(to_stamp_ns(to_ros_time(stamp_ns)), stamp_ns);
  }
}

TEST(Time, ClampsWhatRosTimeCannotHold) {
  EXPECT_EQ(to_stamp_ns(to_ros_time(-5)), 0);
  EXPECT_EQ(to_stamp_ns(to_ros_time(std::numeric_limits<std::int64_t>::max())), 4294967295999999999);
}

TEST(FrameIds, LoseOneLeadingSlash) {
  EXPECT_EQ(strip_leading_slash("/openni_rgb_optical_frame"), "openni_rgb_optical_frame");
  EXPECT_EQ(strip_leading_slash("world"), "world");
  EXPECT_EQ(strip_leading_slash(""), "");
}

TEST(Conversions, FrameIsBitExactThroughTheWire) {
  Random random(1);
  for (int i = 0; i < 100; ++i) {
    core::Frame frame;
    frame.frame_id = random.integer();
    frame.stamp_ns = 1311868164363181001 + random.integer();
    frame.keyframe_id = random.integer();
    frame.is_keyframe = random.flag();
    frame.is_break = random.flag();
    frame.is_end = random.flag();
    frame.T_odom_camera = random.pose();
    if (random.flag()) frame.covariance = random.matrix<core::Mat6>();
    frame.camera = {520.9 + random.number(), 521.0, random.number(), random.number(), 640, 480, {}};
    for (double& value : frame.camera.distortion) value = random.number();
    if (random.flag()) {
      const Eigen::Vector3f p = random.vector().cast<float>();
      frame.points_camera = std::make_shared<const std::vector<core::Vec3>>(3, p.cast<double>());
    }
    Frame message;
    to_msg(frame, &message);
    const core::Frame back = from_msg(over_the_wire(message));
    EXPECT_EQ(back.frame_id, frame.frame_id);
    EXPECT_EQ(back.stamp_ns, frame.stamp_ns);
    EXPECT_EQ(back.keyframe_id, frame.keyframe_id);
    EXPECT_EQ(back.is_keyframe, frame.is_keyframe);
    EXPECT_EQ(back.is_break, frame.is_break);
    EXPECT_EQ(back.is_end, frame.is_end);
    expect_same(back.T_odom_camera, frame.T_odom_camera);
    ASSERT_EQ(back.covariance.has_value(), frame.covariance.has_value());
    if (frame.covariance) {
      EXPECT_TRUE(same_matrix(*back.covariance, *frame.covariance));
    }
    EXPECT_TRUE(same_matrix(back.camera.intrinsics(), frame.camera.intrinsics()));
    EXPECT_EQ(back.camera.distortion, frame.camera.distortion);
    EXPECT_EQ(back.camera.width, 640);
    EXPECT_EQ(back.camera.height, 480);
    ASSERT_EQ(back.points_camera != nullptr, frame.points_camera != nullptr);
    if (frame.points_camera) {
      EXPECT_EQ(*back.points_camera, *frame.points_camera);
    }
  }
}

TEST(Conversions, KeyframeCarriesPoseAndIds) {
  Random random(2);
  core::Frame frame;
  frame.frame_id = 17;
  frame.keyframe_id = 4;
  frame.stamp_ns = 1000000001;
  frame.T_odom_camera = random.pose();
  Keyframe message;
  to_msg(frame, &message);
  EXPECT_EQ(message.frame_id, 17);
  EXPECT_EQ(message.keyframe_id, 4);
  EXPECT_EQ(to_stamp_ns(message.header.stamp), 1000000001);
  expect_same(from_msg(message.odom_from_camera), frame.T_odom_camera);
}

TEST(Conversions, DetectionsAreBitExact) {
  Random random(3);
  const std::vector<core::Detection> detections = {{62, random.number(), random.box()}, {-1, 0.1, random.box()}};
  DetectionArray message;
  to_msg(detections, &message);
  const std::vector<core::Detection> back = from_msg(over_the_wire(message));
  ASSERT_EQ(back.size(), detections.size());
  for (std::size_t i = 0; i < back.size(); ++i) {
    EXPECT_EQ(back[i].class_id, detections[i].class_id);
    EXPECT_TRUE(same_bits(back[i].score, detections[i].score));
    expect_same(back[i].box, detections[i].box);
  }
}

TEST(Conversions, AssociationsAreBitExact) {
  Random random(4);
  core::AssociationFrame frame;
  frame.frame_id = random.integer();
  frame.map_version = 1ull << 40;
  frame.duration_us = random.number();
  for (int level = 0; level <= 8; ++level) {
    frame.associations.push_back({level, random.integer(), static_cast<core::AssociationLevel>(level), random.small(),
                                  random.number(), random.box(), static_cast<std::uint8_t>(level), random.small()});
  }
  AssociationArray message;
  to_msg(frame, &message);
  const core::AssociationFrame back = from_msg(over_the_wire(message));
  EXPECT_EQ(back.frame_id, frame.frame_id);
  EXPECT_EQ(back.map_version, frame.map_version);
  EXPECT_TRUE(same_bits(back.duration_us, frame.duration_us));
  ASSERT_EQ(back.associations.size(), frame.associations.size());
  for (std::size_t i = 0; i < back.associations.size(); ++i) {
    const core::Association &a = back.associations[i], &b = frame.associations[i];
    EXPECT_EQ(a.detection_index, b.detection_index);
    EXPECT_EQ(a.landmark_id, b.landmark_id);
    EXPECT_EQ(a.level, b.level);
    EXPECT_EQ(a.class_id, b.class_id);
    EXPECT_TRUE(same_bits(a.score, b.score));
    expect_same(a.box, b.box);
    EXPECT_EQ(a.truncated, b.truncated);
    EXPECT_EQ(a.landmark_class_id, b.landmark_class_id);
  }
}

TEST(Conversions, MapUpdateIsBitExact) {
  Random random(5);
  for (int i = 0; i < 50; ++i) {
    core::MapUpdate update;
    update.frame_id = random.integer();
    update.phase = random.flag() ? core::MapUpdatePhase::kCorrection : core::MapUpdatePhase::kObservation;
    update.base_version = 7;
    update.map_version = 8;
    update.T_map_odom = random.pose();
    for (int j = 0; j < 4; ++j) update.changed.push_back(random_landmark(&random));
    update.removed = {random.integer(), random.integer()};
    update.merged = {{5, 2}, {2, 1}};
    update.unmerged = {{7, 6}};
    update.duration_us = random.number();
    QuadricMapUpdate message;
    to_msg(update, &message);
    const core::MapUpdate back = from_msg(over_the_wire(message));
    EXPECT_EQ(back.frame_id, update.frame_id);
    EXPECT_EQ(back.phase, update.phase);
    EXPECT_EQ(back.base_version, 7u);
    EXPECT_EQ(back.map_version, 8u);
    expect_same(back.T_map_odom, update.T_map_odom);
    ASSERT_EQ(back.changed.size(), update.changed.size());
    for (std::size_t j = 0; j < back.changed.size(); ++j) expect_same(back.changed[j], update.changed[j]);
    EXPECT_EQ(back.removed, update.removed);
    ASSERT_EQ(back.unmerged.size(), 1u);
    EXPECT_EQ(back.unmerged[0].merged_id, 7);
    EXPECT_EQ(back.unmerged[0].survivor_id, 6);
    ASSERT_EQ(back.merged.size(), 2u);
    EXPECT_EQ(back.merged[1].merged_id, 2);
    EXPECT_EQ(back.merged[1].survivor_id, 1);
    EXPECT_TRUE(same_bits(back.duration_us, update.duration_us));
  }
}

TEST(Conversions, FullMapHasEveryLandmark) {
  Random random(6);
  QuadricMap message;
  message.map_version = 12;
  const core::SE3 T_map_odom = random.pose();
  message.map_from_odom = to_msg(T_map_odom);
  const std::vector<core::Landmark> landmarks = {random_landmark(&random), random_landmark(&random)};
  message.quadrics = to_msg(landmarks);
  const core::MapUpdate update = from_msg(over_the_wire(message));
  EXPECT_EQ(update.map_version, 12u);
  expect_same(update.T_map_odom, T_map_odom);
  ASSERT_EQ(update.changed.size(), 2u);
  expect_same(update.changed[0], landmarks[0]);
  expect_same(update.changed[1], landmarks[1]);
}

TEST(Conversions, LoopsAreBitExact) {
  Random random(7);
  std::vector<core::LoopClosure> loops;
  for (int i = 0; i < 6; ++i) loops.push_back(random_loop(&random));
  LoopClosureArray message;
  to_msg(loops, &message);
  const std::vector<core::LoopClosure> back = from_msg(over_the_wire(message));
  ASSERT_EQ(back.size(), loops.size());
  for (std::size_t i = 0; i < back.size(); ++i) {
    const core::LoopClosure &a = back[i], &b = loops[i];
    EXPECT_EQ(a.query_keyframe_id, b.query_keyframe_id);
    EXPECT_EQ(a.match_keyframe_id, b.match_keyframe_id);
    EXPECT_EQ(a.query_frame, b.query_frame);
    EXPECT_EQ(a.match_frame, b.match_frame);
    EXPECT_EQ(a.query_stamp_ns, b.query_stamp_ns);
    EXPECT_EQ(a.match_stamp_ns, b.match_stamp_ns);
    EXPECT_EQ(a.query_begin, b.query_begin);
    EXPECT_EQ(a.query_end, b.query_end);
    EXPECT_EQ(a.match_begin, b.match_begin);
    EXPECT_EQ(a.match_end, b.match_end);
    EXPECT_EQ(a.accepted, b.accepted);
    EXPECT_EQ(a.reason, b.reason);
    EXPECT_TRUE(same_bits(a.score, b.score));
    EXPECT_TRUE(same_bits(a.second_score, b.second_score));
    EXPECT_TRUE(same_bits(a.rms_m, b.rms_m));
    EXPECT_TRUE(same_bits(a.spread_m, b.spread_m));
    EXPECT_TRUE(same_bits(a.tilt_deg, b.tilt_deg));
    EXPECT_TRUE(same_bits(a.reprojection_ratio, b.reprojection_ratio));
    EXPECT_EQ(a.reprojected_objects, b.reprojected_objects);
    EXPECT_TRUE(same_bits(a.explained_share, b.explained_share));
    EXPECT_TRUE(same_bits(a.refine_residual, b.refine_residual));
    EXPECT_TRUE(same_bits(a.refine_shift_m, b.refine_shift_m));
    EXPECT_TRUE(same_bits(a.refine_shift_deg, b.refine_shift_deg));
    EXPECT_TRUE(same_bits(a.sigma_m, b.sigma_m));
    EXPECT_TRUE(same_bits(a.sigma_deg, b.sigma_deg));
    ASSERT_EQ(a.T_earlier_match.has_value(), b.T_earlier_match.has_value());
    if (a.T_earlier_match) expect_same(*a.T_earlier_match, *b.T_earlier_match);
    EXPECT_EQ(a.inliers, b.inliers);
    EXPECT_EQ(a.labels, b.labels);
    expect_same(a.T_match_query, b.T_match_query);
    EXPECT_TRUE(same_matrix(a.covariance, b.covariance));
    EXPECT_TRUE(same_bits(a.scale, b.scale));
    EXPECT_TRUE(same_matrix(a.scale_covariance, b.scale_covariance));
    ASSERT_EQ(a.matches.size(), b.matches.size());
    EXPECT_EQ(a.matches[1].query_landmark_id, b.matches[1].query_landmark_id);
    EXPECT_EQ(a.matches[1].match_landmark_id, b.matches[1].match_landmark_id);
  }
}

TEST(Conversions, CorrectionIsBitExact) {
  Random random(8);
  core::MapCorrection correction;
  correction.frame_id = random.integer();
  correction.changed = true;
  correction.valid_to_keyframe_id = random.integer();
  correction.T_map_odom_old = random.pose();
  correction.T_map_odom = random.pose();
  correction.scale = random.number();
  correction.keyframes = {{1, 2, 1311868164363181001, random.pose()}, {3, 4, 5, random.pose(), random.number()}};
  correction.loops = {{9, 1, true, "", false}, {12, 3, false, "it is wrong", false}};
  correction.odometry = {3, 0.1, 0.2, 0.3, 0.4, 0.5, 1.5, {{4, 5, true, 0.0, 0.0}, {7, 8, false, 0.6, 0.7}}};
  correction.duration_us = random.number();
  MapCorrection message;
  to_msg(correction, &message);
  const core::MapCorrection back = from_msg(over_the_wire(message));
  EXPECT_EQ(back.frame_id, correction.frame_id);
  EXPECT_TRUE(back.changed);
  EXPECT_EQ(back.valid_to_keyframe_id, correction.valid_to_keyframe_id);
  expect_same(back.T_map_odom_old, correction.T_map_odom_old);
  expect_same(back.T_map_odom, correction.T_map_odom);
  ASSERT_EQ(back.keyframes.size(), 2u);
  EXPECT_EQ(back.keyframes[0].keyframe_id, 1);
  EXPECT_EQ(back.keyframes[0].frame_id, 2);
  EXPECT_EQ(back.keyframes[0].stamp_ns, 1311868164363181001);
  expect_same(back.keyframes[1].T_map_camera, correction.keyframes[1].T_map_camera);
  EXPECT_EQ(back.keyframes[0].scale, 1.0);
  EXPECT_TRUE(same_bits(back.keyframes[1].scale, correction.keyframes[1].scale));
  EXPECT_TRUE(same_bits(back.scale, correction.scale));
  ASSERT_EQ(back.loops.size(), 2u);
  EXPECT_EQ(back.loops[1].query_keyframe_id, 12);
  EXPECT_EQ(back.loops[1].match_keyframe_id, 3);
  EXPECT_FALSE(back.loops[1].kept);
  EXPECT_EQ(back.loops[1].reason, "it is wrong");
  EXPECT_EQ(back.odometry.stated_edges, 3);
  EXPECT_EQ(back.odometry.translation_m, 0.1);
  EXPECT_EQ(back.odometry.rotation_rad, 0.2);
  EXPECT_EQ(back.odometry.steady_translation, 0.3);
  EXPECT_EQ(back.odometry.steady_rotation_rad, 0.4);
  EXPECT_EQ(back.odometry.scale, 0.5);
  EXPECT_EQ(back.odometry.loop_factor, 1.5);
  ASSERT_EQ(back.odometry.faults.size(), 2u);
  EXPECT_TRUE(back.odometry.faults[0].is_break);
  EXPECT_EQ(back.odometry.faults[1].from_keyframe_id, 7);
  EXPECT_EQ(back.odometry.faults[1].to_keyframe_id, 8);
  EXPECT_FALSE(back.odometry.faults[1].is_break);
  EXPECT_EQ(back.odometry.faults[1].translation_m, 0.6);
  EXPECT_EQ(back.odometry.faults[1].rotation_rad, 0.7);
  EXPECT_TRUE(same_bits(back.duration_us, correction.duration_us));
}

TEST(Conversions, PointsOfAKeyframeComeBackBitForBitAndBadOnesAreNamed) {
  core::KeyframePoints points;
  points.sparse = {{5, {0.1F, -0.2F, 1.5F}}, {1LL << 41, {1.0F, 2.0F, 3.0F}}};
  points.semi_dense = {{0.3F, 0.4F, 0.5F}, {-1.0F, 0.0F, 1e-3F}};
  core::Frame keyframe;
  keyframe.keyframe_id = 7;
  keyframe.stamp_ns = 1305031910765326000;
  keyframe.is_keyframe = true;
  keyframe.T_odom_camera = core::SE3(core::so3_exp(core::Vec3(0.1, 0.2, 0.3)), core::Vec3(1.0, 2.0, 3.0));
  keyframe.keyframe_points = std::make_shared<const core::KeyframePoints>(points);
  KeyframePoints message;
  to_msg(keyframe, &message);
  std::string error;
  const std::optional<core::Frame> back = from_msg(message, &error);
  ASSERT_TRUE(back) << error;
  EXPECT_TRUE(back->is_keyframe);
  EXPECT_EQ(back->keyframe_id, 7);
  EXPECT_EQ(back->stamp_ns, keyframe.stamp_ns);
  EXPECT_EQ(back->T_odom_camera.t, keyframe.T_odom_camera.t);
  EXPECT_EQ(back->keyframe_points->semi_dense, points.semi_dense);
  ASSERT_EQ(back->keyframe_points->sparse.size(), 2U);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(back->keyframe_points->sparse[i].id, points.sparse[i].id);
    EXPECT_EQ(back->keyframe_points->sparse[i].point_camera, points.sparse[i].point_camera);
  }
  message.sparse_ids.pop_back();
  EXPECT_FALSE(from_msg(message, &error));
  EXPECT_NE(error.find("sparse_ids"), std::string::npos);
  EXPECT_FALSE(from_msg(KeyframePoints(), &error)) << "clouds without fields";
}

}  // namespace
}  // namespace semantic_topo_loop
