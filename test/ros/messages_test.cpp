#include "semantic_topo_loop/ros/messages.h"

#include <gtest/gtest.h>

#include <random>
#include <regex>

namespace semantic_topo_loop {
namespace {

/// Doubles of every size, and quaternions that are not quite unit: what a message must not touch.
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
  core::LandmarkMerge merge() { return {integer(), integer()}; }
  core::Landmark landmark() {
    std::optional<core::Ellipsoid> ellipsoid;
    if (flag()) ellipsoid = core::Ellipsoid{pose(), vector()};
    return {integer(),
            small(),
            static_cast<core::LandmarkState>(small() % 3),
            ellipsoid,
            matrix<core::Mat3>(),
            integer(),
            small(),
            number(),
            number(),
            number(),
            {{small(), small()}, {small(), small()}}};
  }
  std_msgs::Header header() {
    std_msgs::Header header;
    header.stamp = ros::Time(1311868164, static_cast<std::uint32_t>(small()));
    header.frame_id = "frame" + std::to_string(small());
    return header;
  }
  /// A message of the value, with a header and a session of its own.
  template <class Message>
  Message message(typename Message::Value value) {
    return {header(), static_cast<std::uint32_t>(small()), std::move(value)};
  }

 private:
  std::mt19937_64 engine_;
};

template <class Value>
std::vector<std::uint8_t> bytes(const Value& value) {
  std::vector<std::uint8_t> result(ros::serialization::serializationLength(value));
  ros::serialization::OStream stream(result.data(), static_cast<std::uint32_t>(result.size()));
  stream.next(value);
  EXPECT_EQ(stream.getLength(), 0u);
  return result;
}

/// What a subscriber of another type makes of the bytes.
template <class Other, class Value>
Other as(const Value& value) {
  std::vector<std::uint8_t> data = bytes(value);
  ros::serialization::IStream stream(data.data(), static_cast<std::uint32_t>(data.size()));
  Other other;
  stream.next(other);
  EXPECT_EQ(stream.getLength(), 0u);
  return other;
}

/// To the last bit, NaN and -0 included.
template <class A, class B>
bool same(const A& a, const B& b) {
  return bytes(a) == bytes(b);
}

/// The generated type reads the value's bytes, writes the same ones, and the value comes back from them.
/// @return what the generated type holds, for a look at its fields
template <class Mine>
auto expect_generated_is_same(const Mine& message) {
  using Generated = typename Mine::Generated;
  EXPECT_STREQ(ros::message_traits::md5sum<Mine>(), ros::message_traits::md5sum<Generated>());
  EXPECT_STREQ(ros::message_traits::datatype<Mine>(), ros::message_traits::datatype<Generated>());
  EXPECT_STREQ(ros::message_traits::definition<Mine>(), ros::message_traits::definition<Generated>());
  EXPECT_TRUE(ros::message_traits::hasHeader<Mine>()) << "else roscpp writes no sequence number";
  const auto generated = as<Generated>(message);
  EXPECT_TRUE(same(generated, message));
  EXPECT_TRUE(same(as<Mine>(generated), message));
  EXPECT_TRUE(same(generated.header, message.header));
  EXPECT_EQ(generated.session_id, message.session_id);
  return generated;
}

CameraFrame random_frame(Random* random) {
  CameraFrame frame;
  frame.frame_id = random->integer();
  frame.keyframe_id = random->integer();
  frame.is_keyframe = random->flag();
  frame.is_break = random->flag();
  frame.is_end = random->flag();
  frame.T_odom_camera = random->pose();
  if (random->flag()) frame.held_since_ns = random->integer();
  if (random->flag()) frame.covariance = random->matrix<core::Mat6>();
  if (random->flag()) {
    frame.source_loop = core::SourceLoop{random->integer(), random->pose(), random->matrix<core::Mat6>(), 87};
  }
  frame.camera = {520.9 + random->number(), 521.0, random->number(), random->number(), 640, 480, {}};
  for (double& value : frame.camera.distortion) value = random->number();
  if (random->flag()) {
    const Eigen::Vector3f p = random->vector().cast<float>();
    frame.points_camera = std::make_shared<const std::vector<core::Vec3>>(3, p.cast<double>());
  }
  if (random->flag()) {
    const core::PointFeature feature{random->integer(), random->vector().cast<float>(), {1, ~std::uint64_t{0}, 3, 4}};
    frame.features = std::make_shared<const std::vector<core::PointFeature>>(2, feature);
  }
  frame.camera_frame = "camera" + std::to_string(random->small());
  return frame;
}

TEST(Messages, Frame) {
  Random random(1);
  for (int i = 0; i < 50; ++i) {
    const FrameMessage message = random.message<FrameMessage>(random_frame(&random));
    const Frame generated = expect_generated_is_same(message);
    EXPECT_EQ(generated.frame_id, message.frame_id);
    EXPECT_EQ(generated.keyframe_id, message.keyframe_id);
    EXPECT_EQ(generated.is_keyframe != 0, message.is_keyframe);
    EXPECT_EQ(generated.is_break != 0, message.is_break);
    EXPECT_EQ(generated.is_end != 0, message.is_end);
    EXPECT_TRUE(same(generated.odom_from_camera, message.T_odom_camera));
    EXPECT_EQ(generated.has_caught_up != 0, message.held_since_ns.has_value());
    EXPECT_EQ(generated.held_since_ns, message.held_since_ns.value_or(0));
    ASSERT_EQ(generated.has_covariance != 0, message.covariance.has_value());
    EXPECT_EQ(generated.covariance[1], message.covariance ? (*message.covariance)(0, 1) : 0.0) << "row-major";
    ASSERT_EQ(generated.has_source_loop != 0, message.source_loop.has_value());
    if (message.source_loop) {
      EXPECT_EQ(generated.source_loop.stamp_ns, message.source_loop->stamp_ns);
      EXPECT_TRUE(same(generated.source_loop.odom_from_camera, message.source_loop->T_odom_camera));
      EXPECT_EQ(generated.source_loop.covariance[1], message.source_loop->covariance(0, 1)) << "row-major";
      EXPECT_EQ(generated.source_loop.points, 87);
    }
    EXPECT_EQ(generated.camera_frame, message.camera_frame);
    EXPECT_TRUE(same(generated.camera.header.stamp, message.header.stamp));
    EXPECT_EQ(generated.camera.header.frame_id, message.camera_frame);
    EXPECT_EQ(generated.camera.K[4], message.camera.fy);
    EXPECT_EQ(generated.points.header.frame_id, message.camera_frame);
    EXPECT_EQ(generated.points.width, message.points_camera ? 3u : 0u);
    EXPECT_EQ(generated.features.size(), message.features ? 2u : 0u);

    const auto before = decoded_frames();
    const auto back = as<FrameMessage>(generated);
    EXPECT_EQ(decoded_frames(), before + 1);
    EXPECT_EQ(back.stamp_ns, static_cast<std::int64_t>(message.header.stamp.toNSec()));
    EXPECT_TRUE(same(back.camera.intrinsics(), message.camera.intrinsics()));
    EXPECT_EQ(back.camera.distortion, message.camera.distortion);
    EXPECT_EQ(back.camera.width, 640);
    EXPECT_EQ(back.camera.height, 480);
    ASSERT_EQ(back.points_camera != nullptr, message.points_camera != nullptr);
    if (message.points_camera) {
      EXPECT_EQ(*back.points_camera, *message.points_camera);
    }
    ASSERT_EQ(back.features != nullptr, message.features != nullptr);
    if (message.features) {
      EXPECT_EQ(back.features->back().id, message.features->back().id);
      EXPECT_EQ(back.features->back().position, message.features->back().position);
      EXPECT_EQ(back.features->back().descriptor, message.features->back().descriptor);
    }
  }
}

TEST(Messages, KeyframePointsAndBadOnesAreNamed) {
  Random random(2);
  core::KeyframePoints points;
  points.sparse = {{5, {0.1F, -0.2F, 1.5F}}, {1LL << 41, {1.0F, 2.0F, 3.0F}}};
  points.semi_dense = {{0.3F, 0.4F, 0.5F}, {-1.0F, 0.0F, 1e-3F}};
  PointsKeyframe keyframe;
  keyframe.keyframe_id = 7;
  keyframe.T_odom_camera = random.pose();
  keyframe.keyframe_points = std::make_shared<const core::KeyframePoints>(points);
  const KeyframePointsMessage message = random.message<KeyframePointsMessage>(keyframe);
  KeyframePoints generated = expect_generated_is_same(message);
  EXPECT_EQ(generated.keyframe_id, 7);
  EXPECT_TRUE(same(generated.odom_from_camera, message.T_odom_camera));
  EXPECT_EQ(generated.semi_dense.header.frame_id, message.header.frame_id);

  const auto back = as<KeyframePointsMessage>(generated);
  ASSERT_TRUE(back.keyframe_points) << back.problem;
  EXPECT_TRUE(back.is_keyframe);
  EXPECT_EQ(back.stamp_ns, static_cast<std::int64_t>(message.header.stamp.toNSec()));
  EXPECT_EQ(back.keyframe_points->semi_dense, points.semi_dense);
  ASSERT_EQ(back.keyframe_points->sparse.size(), 2U);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(back.keyframe_points->sparse[i].id, points.sparse[i].id);
    EXPECT_EQ(back.keyframe_points->sparse[i].point_camera, points.sparse[i].point_camera);
  }
  generated.sparse_ids.pop_back();
  const auto incomplete = as<KeyframePointsMessage>(generated);
  EXPECT_FALSE(incomplete.keyframe_points);
  EXPECT_NE(incomplete.problem.find("sparse_ids"), std::string::npos);
  EXPECT_FALSE(as<KeyframePointsMessage>(KeyframePoints()).keyframe_points) << "clouds without fields";
}

TEST(Messages, Detections) {
  Random random(3);
  const DetectionsMessage message = random.message<DetectionsMessage>(
      FrameDetections{random.integer(), true, {{62, random.number(), random.box()}, {-1, 0.1, random.box()}}});
  const DetectionArray generated = expect_generated_is_same(message);
  EXPECT_EQ(generated.frame_id, message.frame_id);
  EXPECT_TRUE(generated.unanswered);
  ASSERT_EQ(generated.detections.size(), 2u);
  EXPECT_EQ(generated.detections[0].class_id, 62);
  EXPECT_EQ(generated.detections[0].score, message.detections[0].score);
  const Box& box = generated.detections[0].box;
  EXPECT_TRUE(same(core::Vec4(box.x1, box.y1, box.x2, box.y2), message.detections[0].box.edges()));
}

TEST(Messages, Associations) {
  Random random(4);
  core::AssociationFrame associations{random.integer(), true, 1ull << 40, {}, random.number()};
  for (int level = 0; level <= 9; ++level) {
    associations.associations.push_back({level, random.integer(), static_cast<core::AssociationLevel>(level),
                                         random.small(), random.number(), random.box(),
                                         static_cast<std::uint8_t>(2 * level), random.small(), random.number()});
  }
  const AssociationsMessage message = random.message<AssociationsMessage>(associations);
  const AssociationArray generated = expect_generated_is_same(message);
  EXPECT_EQ(generated.frame_id, message.frame_id);
  EXPECT_TRUE(generated.unanswered);
  EXPECT_EQ(generated.map_version, message.map_version);
  EXPECT_EQ(generated.duration_us, message.duration_us);
  ASSERT_EQ(generated.associations.size(), 10u);
  const Association& last = generated.associations.back();
  EXPECT_EQ(last.detection_index, 9);
  EXPECT_EQ(last.landmark_id, associations.associations[9].landmark_id);
  EXPECT_EQ(last.level, Association::LEVEL_WRONG_SIZE);
  EXPECT_EQ(last.class_id, associations.associations[9].class_id);
  EXPECT_EQ(last.score, associations.associations[9].score);
  EXPECT_TRUE(same(last.box, associations.associations[9].box));
  EXPECT_EQ(last.truncated, 18);
  EXPECT_EQ(last.landmark_class_id, associations.associations[9].landmark_class_id);
  EXPECT_EQ(last.near_m, associations.associations[9].near_m);
}

void expect_same(const Quadric& message, const core::Landmark& landmark) {
  EXPECT_EQ(message.id, landmark.id);
  EXPECT_EQ(message.class_id, landmark.class_id);
  EXPECT_EQ(message.state, static_cast<std::uint8_t>(landmark.state));
  ASSERT_EQ(message.has_ellipsoid != 0, landmark.ellipsoid.has_value());
  const core::Ellipsoid ellipsoid = landmark.ellipsoid.value_or(core::Ellipsoid());
  EXPECT_TRUE(same(message.map_from_quadric, ellipsoid.T_world_quadric));
  EXPECT_TRUE(same(message.semi_axes, ellipsoid.semi_axes));
  EXPECT_EQ(message.center_covariance[1], landmark.center_covariance(0, 1)) << "row-major";
  EXPECT_EQ(message.anchor_keyframe_id, landmark.anchor_keyframe_id);
  EXPECT_EQ(message.observations, landmark.observations);
  EXPECT_EQ(message.baseline_deg, landmark.baseline_deg);
  EXPECT_EQ(message.mean_iou, landmark.mean_iou);
  EXPECT_EQ(message.quality, landmark.quality);
  ASSERT_EQ(message.class_counts.size(), landmark.class_counts.size());
  EXPECT_EQ(message.class_counts[1].class_id, landmark.class_counts[1].class_id);
  EXPECT_EQ(message.class_counts[1].count, landmark.class_counts[1].count);
}

TEST(Messages, MapUpdateAndFullMap) {
  Random random(5);
  for (int i = 0; i < 50; ++i) {
    FullMap update;
    update.frame_id = random.integer();
    update.phase = random.flag() ? core::MapUpdatePhase::kCorrection : core::MapUpdatePhase::kObservation;
    update.base_version = 7;
    update.map_version = 8;
    update.T_map_odom = random.pose();
    for (int j = 0; j < 4; ++j) update.changed.push_back(random.landmark());
    update.removed = {random.integer(), random.integer()};
    update.unmerged = {random.merge()};
    update.merged = {random.merge(), random.merge()};
    update.duration_us = random.number();
    const MapUpdateMessage message = random.message<MapUpdateMessage>(update);
    const QuadricMapUpdate generated = expect_generated_is_same(message);
    EXPECT_EQ(generated.frame_id, update.frame_id);
    EXPECT_EQ(generated.phase, static_cast<std::uint8_t>(update.phase));
    EXPECT_EQ(generated.base_version, 7u);
    EXPECT_EQ(generated.map_version, 8u);
    EXPECT_TRUE(same(generated.map_from_odom, update.T_map_odom));
    ASSERT_EQ(generated.changed.size(), 4u);
    for (std::size_t j = 0; j < 4; ++j) expect_same(generated.changed[j], update.changed[j]);
    EXPECT_EQ(generated.removed, update.removed);
    EXPECT_TRUE(same(generated.unmerged, update.unmerged));
    ASSERT_EQ(generated.merged.size(), 2u);
    EXPECT_EQ(generated.merged[1].merged_id, update.merged[1].merged_id);
    EXPECT_EQ(generated.merged[1].survivor_id, update.merged[1].survivor_id);
    EXPECT_EQ(generated.duration_us, update.duration_us);

    const QuadricMap map = expect_generated_is_same(random.message<MapMessage>(update));
    EXPECT_EQ(map.map_version, 8u);
    EXPECT_TRUE(same(map.map_from_odom, update.T_map_odom));
    EXPECT_TRUE(same(map.quadrics, update.changed));
  }
}

/// The order of the names is the order of the values: see the next test for those.
TEST(Messages, LoopClosureNamesItsFieldsAsTheMessageDoes) {
  std::vector<std::string> expected, names;
  std::istringstream definition(ros::message_traits::definition<LoopClosure>());
  const std::regex field("([a-zA-Z0-9_/\\[\\]]+) +([a-z0-9_]+)( *#.*)?");
  std::smatch match;
  for (std::string line; std::getline(definition, line) && line.find("=====") == std::string::npos;) {
    if (std::regex_match(line, match, field)) expected.push_back(match[2]);
  }
  core::LoopClosure loop;
  core::visit_fields(loop, [&names](const char* name, auto& value) {
    using Field = std::remove_reference_t<decltype(value)>;
    if (std::is_same_v<Field, std::optional<core::SE3>>) names.emplace_back("in_earlier_map");
    names.emplace_back(name);
  });
  EXPECT_FALSE(expected.empty());
  EXPECT_EQ(names, expected);
}

TEST(Messages, Loops) {
  Random random(7);
  FrameLoops loops{random.integer(), random.number(), {}, {}, core::Relocalisation{random.pose(), 5, 7}};
  for (int i = 0; i < 6; ++i) {
    core::LoopClosure loop;
    core::visit_fields(loop, [&random](const char*, auto& field) {
      using Field = std::remove_reference_t<decltype(field)>;
      if constexpr (std::is_same_v<Field, double>) {
        field = random.number();
      } else if constexpr (std::is_same_v<Field, bool>) {
        field = random.flag();
      } else if constexpr (std::is_integral_v<Field>) {
        field = static_cast<Field>(random.integer());
      } else if constexpr (std::is_enum_v<Field>) {
        field = static_cast<Field>(random.small() % 14);
      }
    });
    loop.T_match_query = random.pose();
    loop.covariance = random.matrix<core::Mat6>();
    loop.scale_covariance = random.matrix<core::Mat7>().col(2);
    loop.matches = {{random.integer(), random.integer()}, {random.integer(), random.integer()}};
    loop.query_objects = {{random.integer(), 41, random.pose().t, random.number()}};
    loop.match_objects = {{random.integer(), 42, random.pose().t, random.number()},
                          {random.integer(), 43, random.pose().t, random.number()}};
    if (i % 2 == 0) loop.T_earlier_match = random.pose();
    loops.closures.push_back(loop);
  }
  for (int i = 0; i < 3; ++i) {
    loops.motions.push_back({random.integer(),
                             random.integer(),
                             random.pose(),
                             random.number(),
                             random.number(),
                             {random.number(), random.number(), random.matrix<core::Mat6>()},
                             random.number(),
                             {random.number(), random.number(), random.number(), random.number()}});
  }
  const LoopsMessage message = random.message<LoopsMessage>(loops);
  const LoopClosureArray generated = expect_generated_is_same(message);
  EXPECT_EQ(generated.frame_id, loops.frame_id);
  EXPECT_EQ(generated.duration_us, loops.duration_us);
  ASSERT_EQ(generated.closures.size(), 6u);
  for (std::size_t i = 0; i < 6; ++i) {
    const core::LoopClosure& loop = loops.closures[i];
    EXPECT_TRUE(same(to_generated<LoopClosure>(loop), generated.closures[i]));
    EXPECT_EQ(generated.closures[i].query_keyframe_id, loop.query_keyframe_id);
    EXPECT_EQ(generated.closures[i].accepted != 0, loop.accepted);
    EXPECT_EQ(generated.closures[i].reason, static_cast<std::uint8_t>(loop.reason));
    EXPECT_EQ(generated.closures[i].sigma_deg, loop.sigma_deg);
    EXPECT_EQ(generated.closures[i].matches[1].query_landmark_id, loop.matches[1].query_landmark_id);
    EXPECT_EQ(generated.closures[i].query_objects[0].position.y, loop.query_objects[0].position.y());
    EXPECT_EQ(generated.closures[i].match_objects[1].class_id, 43);
    EXPECT_EQ(generated.closures[i].match_objects[1].radius_m, loop.match_objects[1].radius_m);
    EXPECT_EQ(generated.closures[i].in_earlier_map != 0, loop.T_earlier_match.has_value());
    EXPECT_TRUE(same(generated.closures[i].earlier_map_from_match, loop.T_earlier_match.value_or(core::SE3())));
  }
  ASSERT_EQ(generated.motions.size(), 3u);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(generated.motions[i].to_keyframe_id, loops.motions[i].to_keyframe_id);
    EXPECT_TRUE(same(generated.motions[i].pose, loops.motions[i].T_from_to));
    EXPECT_EQ(generated.motions[i].path_m, loops.motions[i].path_m);
    EXPECT_EQ(generated.motions[i].frozen_s, loops.motions[i].missed.frozen_s);
    EXPECT_EQ(generated.motions[i].slipped_s, loops.motions[i].missed.slipped_s);
    EXPECT_EQ(generated.motions[i].missed_covariance[1], loops.motions[i].missed.covariance(0, 1)) << "row-major";
    EXPECT_EQ(generated.motions[i].delay_s, loops.motions[i].delay_s);
    EXPECT_EQ(generated.motions[i].noise.drift_radps, loops.motions[i].noise.drift_radps);
  }
  EXPECT_TRUE(generated.has_relocalisation);
  EXPECT_TRUE(same(generated.relocalisation.earlier_map_from_odom, loops.relocalisation->T_earlier_odom));
  EXPECT_EQ(generated.relocalisation.agreeing, 5);
  EXPECT_EQ(generated.relocalisation.total, 7);
  loops.relocalisation.reset();
  EXPECT_FALSE(expect_generated_is_same(random.message<LoopsMessage>(loops)).has_relocalisation);
}

TEST(Messages, Correction) {
  Random random(8);
  core::MapCorrection correction;
  correction.frame_id = random.integer();
  correction.changed = true;
  correction.valid_to_keyframe_id = random.integer();
  correction.T_map_odom_old = random.pose();
  correction.T_map_odom = random.pose();
  correction.scale = random.number();
  correction.keyframes = {{1, 2, 1311868164363181001, random.pose()}, {3, 4, 5, random.pose(), random.number()}};
  correction.loops = {{4, 9, 1, true, "", false}, {7, 12, 3, false, "it is wrong", false}};
  correction.odometry = {3,
                         0.1,
                         0.2,
                         0.3,
                         0.4,
                         0.5,
                         1.5,
                         0.06,
                         {0.01, 0.02, 0.03, 0.04},
                         {{4, 5, true, 0.0, 0.0}, {7, 8, false, 0.6, 0.7}}};
  correction.duration_us = random.number();
  const MapCorrection generated = expect_generated_is_same(random.message<CorrectionMessage>(correction));
  EXPECT_EQ(generated.frame_id, correction.frame_id);
  EXPECT_TRUE(generated.changed);
  EXPECT_EQ(generated.valid_to_keyframe_id, correction.valid_to_keyframe_id);
  EXPECT_TRUE(same(generated.map_from_odom_old, correction.T_map_odom_old));
  EXPECT_TRUE(same(generated.map_from_odom, correction.T_map_odom));
  EXPECT_EQ(generated.scale, correction.scale);
  ASSERT_EQ(generated.keyframes.size(), 2u);
  EXPECT_EQ(generated.keyframes[1].keyframe_id, 3);
  EXPECT_EQ(generated.keyframes[1].frame_id, 4);
  EXPECT_EQ(generated.keyframes[0].stamp_ns, 1311868164363181001);
  EXPECT_TRUE(same(generated.keyframes[1].map_from_camera, correction.keyframes[1].T_map_camera));
  EXPECT_EQ(generated.keyframes[0].scale, 1.0);
  EXPECT_EQ(generated.keyframes[1].scale, correction.keyframes[1].scale);
  ASSERT_EQ(generated.loops.size(), 2u);
  EXPECT_EQ(generated.loops[1].number, 7);
  EXPECT_EQ(generated.loops[1].query_keyframe_id, 12);
  EXPECT_EQ(generated.loops[1].match_keyframe_id, 3);
  EXPECT_FALSE(generated.loops[1].kept);
  EXPECT_EQ(generated.loops[1].reason, "it is wrong");
  EXPECT_EQ(generated.odometry.stated_edges, 3);
  EXPECT_EQ(generated.odometry.translation_m, 0.1);
  EXPECT_EQ(generated.odometry.rotation_rad, 0.2);
  EXPECT_EQ(generated.odometry.steady_translation, 0.3);
  EXPECT_EQ(generated.odometry.steady_rotation_rad, 0.4);
  EXPECT_EQ(generated.odometry.scale, 0.5);
  EXPECT_EQ(generated.odometry.loop_factor, 1.5);
  EXPECT_EQ(generated.odometry.delay_s, 0.06);
  EXPECT_EQ(generated.odometry.short_term.step_m, 0.01);
  EXPECT_EQ(generated.odometry.short_term.step_rad, 0.02);
  EXPECT_EQ(generated.odometry.short_term.drift_mps, 0.03);
  EXPECT_EQ(generated.odometry.short_term.drift_radps, 0.04);
  ASSERT_EQ(generated.odometry.faults.size(), 2u);
  EXPECT_TRUE(generated.odometry.faults[0].is_break);
  EXPECT_EQ(generated.odometry.faults[1].from_keyframe_id, 7);
  EXPECT_EQ(generated.odometry.faults[1].to_keyframe_id, 8);
  EXPECT_EQ(generated.odometry.faults[1].translation_m, 0.6);
  EXPECT_EQ(generated.odometry.faults[1].rotation_rad, 0.7);
  EXPECT_EQ(generated.duration_us, correction.duration_us);
}

TEST(Messages, TrackingReport) {
  core::TrackingReport report;
  report.images = 1;
  report.tracked = 2;
  report.relocalised = 3;
  report.restarts = 4;
  report.lost = 5;
  report.unusable = 6;
  report.unreadable = 7;
  report.first_unreadable = "it is gone";
  const TrackingReport generated = expect_generated_is_same(Random(9).message<TrackingMessage>(report));
  const std::vector<std::int64_t> counts = {generated.images,    generated.tracked, generated.relocalised,
                                            generated.restarts,  generated.lost,    generated.unusable,
                                            generated.unreadable};
  EXPECT_EQ(counts, (std::vector<std::int64_t>{1, 2, 3, 4, 5, 6, 7}));
  EXPECT_EQ(generated.first_unreadable, "it is gone");
}

}  // namespace
}  // namespace semantic_topo_loop
