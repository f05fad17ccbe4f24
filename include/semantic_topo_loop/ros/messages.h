#pragma once

#include <ros/message_traits.h>
#include <ros/serialization.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/PointCloud2.h>
#include <std_msgs/Header.h>

#include <boost/shared_ptr.hpp>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "semantic_topo_loop/AssociationArray.h"
#include "semantic_topo_loop/DetectionArray.h"
#include "semantic_topo_loop/Frame.h"
#include "semantic_topo_loop/KeyframePoints.h"
#include "semantic_topo_loop/LoopClosureArray.h"
#include "semantic_topo_loop/MapCorrection.h"
#include "semantic_topo_loop/MapPart.h"
#include "semantic_topo_loop/QuadricMap.h"
#include "semantic_topo_loop/QuadricMapUpdate.h"
#include "semantic_topo_loop/TrackingReport.h"
#include "semantic_topo_loop/frontend/rgbd_frontend.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/landmark.h"
#include "semantic_topo_loop/types/loop_closure.h"
#include "semantic_topo_loop/types/map_correction.h"
#include "semantic_topo_loop/types/solved_motion.h"

/// The core's values as messages: roscpp's adapted types. What is published as one of the *Message types below goes by
/// the type, the MD5 sum and the bytes of its .msg file, so that rostopic, rosbag, Python and subscribers of the
/// generated C++ types see no difference. Who subscribes to it by the same type in the same process gets the
/// publisher's own object, its clouds included; from another process it is decoded once, however many stages listen.
///
/// Nothing is rounded or normalised on the way but the points of a Frame, which travel as float32.
namespace semantic_topo_loop {

namespace core {
struct MapDelta;
}

/// A value of the core with the header and the session of the stage that says it.
/// @tparam GeneratedType the message of which it has name, sum and bytes
template <class ValueType, class GeneratedType>
struct Stamped : ValueType {
  using Value = ValueType;
  using Generated = GeneratedType;
  using Ptr = boost::shared_ptr<Stamped>;
  using ConstPtr = boost::shared_ptr<const Stamped>;

  Stamped() = default;
  Stamped(std_msgs::Header stage_header, std::uint32_t session, Value value)
      : Value(std::move(value)), header(std::move(stage_header)), session_id(session) {}

  std_msgs::Header header;
  std::uint32_t session_id = 0;
};

/// A frame with the tf frame of its camera's optical frame. Its keyframe_points do not travel with it.
struct CameraFrame : core::Frame {
  std::string camera_frame;
};

/// A keyframe of which id, stamp, pose and keyframe_points travel; the header names the camera's optical frame.
struct PointsKeyframe : core::Frame {
  std::string problem;  ///< why keyframe_points is null: a cloud is none, or there is not one id for each sparse point
};

struct FrameDetections {
  std::int64_t frame_id = 0;
  bool unanswered = false;  ///< the detector did not look at the image
  std::vector<core::Detection> detections;
};

/// Every candidate of one frame, the motions solved for with it, and where the run then is in an earlier run's map.
struct FrameLoops {
  std::int64_t frame_id = 0;
  double duration_us = 0.0;
  std::vector<core::LoopClosure> closures;
  std::vector<core::SolvedMotion> motions;
  std::optional<core::Relocalisation> relocalisation;
};

/// The full map as an update of every landmark; what it follows is left to the holder.
struct FullMap : core::MapUpdate {};

/// What is new in a stage's part of the map.
struct MapPartValue {
  std::int64_t frame_id = 0;
  std::uint8_t stage = MapPart::STAGE_POSE_GRAPH;
  ros::Time loaded;                             ///< when that stage was
  bool is_end = false;                          ///< nothing follows in this session
  std::shared_ptr<const core::MapDelta> delta;  ///< null: what came over a socket is none
};

using FrameMessage = Stamped<CameraFrame, Frame>;
using KeyframePointsMessage = Stamped<PointsKeyframe, KeyframePoints>;
using DetectionsMessage = Stamped<FrameDetections, DetectionArray>;
using AssociationsMessage = Stamped<core::AssociationFrame, AssociationArray>;
using MapUpdateMessage = Stamped<core::MapUpdate, QuadricMapUpdate>;
using MapMessage = Stamped<FullMap, QuadricMap>;
using LoopsMessage = Stamped<FrameLoops, LoopClosureArray>;
using CorrectionMessage = Stamped<core::MapCorrection, MapCorrection>;
using MapPartMessage = Stamped<MapPartValue, MapPart>;
using TrackingMessage = Stamped<core::TrackingReport, TrackingReport>;

/// Frames that this process has decoded so far: one for each that came over a socket.
std::uint64_t decoded_frames();

/// The generated message of a value. @tparam Message its type, e.g. LoopClosure   @param value e.g. core::LoopClosure
template <class Message, class Value>
Message to_generated(const Value& value) {
  std::vector<std::uint8_t> bytes(ros::serialization::serializationLength(value));
  ros::serialization::OStream out(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
  ros::serialization::serialize(out, value);
  ros::serialization::IStream in(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
  Message message;
  ros::serialization::deserialize(in, message);
  return message;
}

/// What follows is how the types above travel: nothing that a stage calls.
namespace wire {

/// The part of Frame.msg that is of sensor_msgs.
struct FrameSensors {
  void take_from(const FrameMessage& frame);
  /// Fills camera, points, features and stamp.
  void give_to(FrameMessage* frame) const;

  sensor_msgs::CameraInfo camera;
  bool has_points = false;
  sensor_msgs::PointCloud2 points;
  std::vector<core::PointFeature> features;
};

/// The part of KeyframePoints.msg that holds the points.
struct KeyframeClouds {
  void take_from(const KeyframePointsMessage& keyframe);
  /// Fills keyframe_points or problem, and the stamp.
  void give_to(KeyframePointsMessage* keyframe) const;

  std::vector<std::int64_t> sparse_ids;
  sensor_msgs::PointCloud2 sparse, semi_dense;
};

/// The part of MapPart.msg that holds the delta.
struct MapBody {
  void take_from(const MapPartMessage& part);
  void give_to(MapPartMessage* part) const;

  std::vector<std::uint8_t> bytes;
};

template <class Stream>
constexpr bool kIsInput = Stream::stream_type == ros::serialization::stream_types::Input;

template <class Stream, class... Fields>
void next(Stream& stream, Fields&... fields) {
  (stream.next(fields), ...);
}

/// What stands for a value that there is not.
template <class Value>
Value absent() {
  if constexpr (std::is_same_v<Value, core::Mat6>) {
    return core::Mat6::Zero();
  } else {
    return Value();
  }
}

/// An enum, as the uint8 of its value.
template <class Enum>
struct EnumSerializer {
  template <class Stream>
  static void write(Stream& stream, const Enum& value) {
    stream.next(static_cast<std::uint8_t>(value));
  }
  template <class Stream>
  static void read(Stream& stream, Enum& value) {
    std::uint8_t byte = 0;
    stream.next(byte);
    value = static_cast<Enum>(byte);
  }
  static std::uint32_t serializedLength(const Enum&) { return 1; }
};

}  // namespace wire
}  // namespace semantic_topo_loop

namespace ros::message_traits {

template <class Value, class Generated>
struct IsMessage<semantic_topo_loop::Stamped<Value, Generated>> : TrueType {};
template <class Value, class Generated>
struct IsMessage<const semantic_topo_loop::Stamped<Value, Generated>> : TrueType {};
template <class Value, class Generated>
struct HasHeader<semantic_topo_loop::Stamped<Value, Generated>> : TrueType {};
template <class Value, class Generated>
struct HasHeader<const semantic_topo_loop::Stamped<Value, Generated>> : TrueType {};

#define SEMANTIC_TOPO_LOOP_AS_GENERATED(Trait)                                                         \
  template <class Value, class Generated>                                                              \
  struct Trait<semantic_topo_loop::Stamped<Value, Generated>> {                                        \
    static const char* value() { return Trait<Generated>::value(); }                                   \
    static const char* value(const semantic_topo_loop::Stamped<Value, Generated>&) { return value(); } \
  };
SEMANTIC_TOPO_LOOP_AS_GENERATED(MD5Sum)
SEMANTIC_TOPO_LOOP_AS_GENERATED(DataType)
SEMANTIC_TOPO_LOOP_AS_GENERATED(Definition)
#undef SEMANTIC_TOPO_LOOP_AS_GENERATED

}  // namespace ros::message_traits

// Each field once, in the order of the .msg file.
namespace ros::serialization {

namespace core = semantic_topo_loop::core;
using semantic_topo_loop::wire::next;

/// Row by row.
template <class Scalar, int rows, int cols>
struct Serializer<Eigen::Matrix<Scalar, rows, cols>> {
  template <class Stream, class T>
  static void allInOne(Stream& stream, T m) {
    for (Eigen::Index row = 0; row < rows; ++row) {
      for (Eigen::Index col = 0; col < cols; ++col) stream.next(m(row, col));
    }
  }
  ROS_DECLARE_ALLINONE_SERIALIZER
};

/// A flag, and the value: a default one if there is none.
template <class Value>
struct Serializer<std::optional<Value>> {
  template <class Stream>
  static void write(Stream& stream, const std::optional<Value>& value) {
    stream.next(value.has_value());
    stream.next(value ? *value : semantic_topo_loop::wire::absent<Value>());
  }
  template <class Stream>
  static void read(Stream& stream, std::optional<Value>& value) {
    bool has_value = false;
    stream.next(has_value);
    stream.next(value.emplace());
    if (!has_value) value.reset();
  }
  static std::uint32_t serializedLength(const std::optional<Value>& value) {
    return 1 + serializationLength(value ? *value : semantic_topo_loop::wire::absent<Value>());
  }
};

template <>
struct Serializer<core::AssociationLevel> : semantic_topo_loop::wire::EnumSerializer<core::AssociationLevel> {};
template <>
struct Serializer<core::LandmarkState> : semantic_topo_loop::wire::EnumSerializer<core::LandmarkState> {};
template <>
struct Serializer<core::LoopReason> : semantic_topo_loop::wire::EnumSerializer<core::LoopReason> {};
template <>
struct Serializer<core::MapUpdatePhase> : semantic_topo_loop::wire::EnumSerializer<core::MapUpdatePhase> {};

/// One line a type: its fields.
#define SEMANTIC_TOPO_LOOP_FIELDS(Type, ...)    \
  template <>                                   \
  struct Serializer<Type> {                     \
    template <class Stream, class T>            \
    static void allInOne(Stream& stream, T m) { \
      next(stream, __VA_ARGS__);                \
    }                                           \
    ROS_DECLARE_ALLINONE_SERIALIZER             \
  };
// A pose: the coefficients of Eigen's quaternion lie in the order x, y, z, w.
SEMANTIC_TOPO_LOOP_FIELDS(core::SE3, m.t, m.q.coeffs())
SEMANTIC_TOPO_LOOP_FIELDS(core::SourceLoop, m.stamp_ns, m.T_odom_camera, m.covariance, m.points)
SEMANTIC_TOPO_LOOP_FIELDS(core::PointFeature, m.id, m.position, m.descriptor[0], m.descriptor[1], m.descriptor[2],
                          m.descriptor[3])
SEMANTIC_TOPO_LOOP_FIELDS(core::Box, m.x1, m.y1, m.x2, m.y2)
SEMANTIC_TOPO_LOOP_FIELDS(core::Detection, m.class_id, m.score, m.box)
SEMANTIC_TOPO_LOOP_FIELDS(core::Association, m.detection_index, m.landmark_id, m.level, m.class_id, m.score, m.box,
                          m.truncated, m.landmark_class_id, m.near_m)
SEMANTIC_TOPO_LOOP_FIELDS(core::Ellipsoid, m.T_world_quadric, m.semi_axes)
SEMANTIC_TOPO_LOOP_FIELDS(core::ClassCount, m.class_id, m.count)
SEMANTIC_TOPO_LOOP_FIELDS(core::Landmark, m.id, m.class_id, m.state, m.ellipsoid, m.center_covariance,
                          m.anchor_keyframe_id, m.observations, m.baseline_deg, m.mean_iou, m.quality, m.class_counts)
SEMANTIC_TOPO_LOOP_FIELDS(core::LandmarkMerge, m.merged_id, m.survivor_id)
SEMANTIC_TOPO_LOOP_FIELDS(core::ObjectMatch, m.query_landmark_id, m.match_landmark_id)
SEMANTIC_TOPO_LOOP_FIELDS(core::SubmapObject, m.landmark_id, m.class_id, m.position, m.radius_m)
SEMANTIC_TOPO_LOOP_FIELDS(core::KeyframePose, m.keyframe_id, m.frame_id, m.stamp_ns, m.T_map_camera, m.scale)
SEMANTIC_TOPO_LOOP_FIELDS(core::LoopVerdict, m.number, m.query_keyframe_id, m.match_keyframe_id, m.kept, m.is_extra,
                          m.reason)
SEMANTIC_TOPO_LOOP_FIELDS(core::OdometryFault, m.from_keyframe_id, m.to_keyframe_id, m.is_break, m.translation_m,
                          m.rotation_rad, m.frozen_s, m.slipped_s)
SEMANTIC_TOPO_LOOP_FIELDS(core::MissedMotion, m.frozen_s, m.slipped_s, m.covariance)
SEMANTIC_TOPO_LOOP_FIELDS(core::ShortTermNoise, m.step_m, m.step_rad, m.drift_mps, m.drift_radps)
SEMANTIC_TOPO_LOOP_FIELDS(core::SolvedMotion, m.from_keyframe_id, m.to_keyframe_id, m.T_from_to, m.path_m,
                          m.rotation_rad, m.missed, m.delay_s, m.noise)
SEMANTIC_TOPO_LOOP_FIELDS(core::OdometryReport, m.stated_edges, m.translation_m, m.rotation_rad, m.steady_translation,
                          m.steady_rotation_rad, m.scale, m.loop_factor, m.delay_s, m.short_term, m.faults)
SEMANTIC_TOPO_LOOP_FIELDS(semantic_topo_loop::FrameDetections, m.frame_id, m.unanswered, m.detections)
SEMANTIC_TOPO_LOOP_FIELDS(core::AssociationFrame, m.frame_id, m.unanswered, m.map_version, m.duration_us,
                          m.associations)
SEMANTIC_TOPO_LOOP_FIELDS(core::MapUpdate, m.frame_id, m.phase, m.base_version, m.map_version, m.T_map_odom, m.changed,
                          m.removed, m.unmerged, m.merged, m.duration_us)
SEMANTIC_TOPO_LOOP_FIELDS(semantic_topo_loop::FullMap, m.map_version, m.T_map_odom, m.changed)
SEMANTIC_TOPO_LOOP_FIELDS(core::Relocalisation, m.T_earlier_odom, m.agreeing, m.total)
SEMANTIC_TOPO_LOOP_FIELDS(semantic_topo_loop::FrameLoops, m.frame_id, m.duration_us, m.closures, m.motions,
                          m.relocalisation)
SEMANTIC_TOPO_LOOP_FIELDS(core::MapCorrection, m.frame_id, m.changed, m.valid_to_keyframe_id, m.T_map_odom_old,
                          m.T_map_odom, m.scale, m.keyframes, m.loops, m.odometry, m.duration_us)
SEMANTIC_TOPO_LOOP_FIELDS(core::TrackingReport, m.images, m.tracked, m.relocalised, m.restarts, m.lost, m.unusable,
                          m.unreadable, m.first_unreadable)
#undef SEMANTIC_TOPO_LOOP_FIELDS

template <>
struct Serializer<core::LoopClosure> {
  template <class Stream, class T>
  static void allInOne(Stream& stream, T m) {
    core::visit_fields(m, [&stream](const char*, auto& field) { stream.next(field); });
  }
  ROS_DECLARE_ALLINONE_SERIALIZER
};

/// Header and session come first in every message.
template <class Value, class Generated>
struct Serializer<semantic_topo_loop::Stamped<Value, Generated>> {
  template <class Stream, class T>
  static void allInOne(Stream& stream, T m) {
    next(stream, m.header, m.session_id);
    Serializer<Value>::template allInOne<Stream, T>(stream, m);
  }
  ROS_DECLARE_ALLINONE_SERIALIZER
};
template <>
struct Serializer<semantic_topo_loop::FrameMessage> {
  template <class Stream, class T>
  static void allInOne(Stream& stream, T m) {
    next(stream, m.header, m.session_id, m.frame_id, m.keyframe_id, m.is_keyframe, m.is_break, m.is_end,
         m.T_odom_camera, m.held_since_ns, m.covariance, m.source_loop, m.camera_frame);
    semantic_topo_loop::wire::FrameSensors sensors;
    if constexpr (!semantic_topo_loop::wire::kIsInput<Stream>) sensors.take_from(m);
    next(stream, sensors.camera, sensors.has_points, sensors.points, sensors.features);
    if constexpr (semantic_topo_loop::wire::kIsInput<Stream>) sensors.give_to(&m);
  }
  ROS_DECLARE_ALLINONE_SERIALIZER
};
template <>
struct Serializer<semantic_topo_loop::KeyframePointsMessage> {
  template <class Stream, class T>
  static void allInOne(Stream& stream, T m) {
    next(stream, m.header, m.session_id, m.keyframe_id, m.T_odom_camera);
    semantic_topo_loop::wire::KeyframeClouds clouds;
    if constexpr (!semantic_topo_loop::wire::kIsInput<Stream>) clouds.take_from(m);
    next(stream, clouds.sparse_ids, clouds.sparse, clouds.semi_dense);
    if constexpr (semantic_topo_loop::wire::kIsInput<Stream>) clouds.give_to(&m);
  }
  ROS_DECLARE_ALLINONE_SERIALIZER
};

template <>
struct Serializer<semantic_topo_loop::MapPartMessage> {
  template <class Stream, class T>
  static void allInOne(Stream& stream, T m) {
    next(stream, m.header, m.session_id, m.frame_id, m.stage, m.loaded, m.is_end);
    semantic_topo_loop::wire::MapBody body;
    if constexpr (!semantic_topo_loop::wire::kIsInput<Stream>) body.take_from(m);
    next(stream, body.bytes);
    if constexpr (semantic_topo_loop::wire::kIsInput<Stream>) body.give_to(&m);
  }
  ROS_DECLARE_ALLINONE_SERIALIZER
};

}  // namespace ros::serialization
