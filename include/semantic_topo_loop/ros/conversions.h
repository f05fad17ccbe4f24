#pragma once

#include <geometry_msgs/Pose.h>
#include <geometry_msgs/Vector3.h>
#include <ros/time.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/PointCloud2.h>

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "semantic_topo_loop/AssociationArray.h"
#include "semantic_topo_loop/DetectionArray.h"
#include "semantic_topo_loop/Frame.h"
#include "semantic_topo_loop/Keyframe.h"
#include "semantic_topo_loop/LoopClosureArray.h"
#include "semantic_topo_loop/MapCorrection.h"
#include "semantic_topo_loop/QuadricMap.h"
#include "semantic_topo_loop/QuadricMapUpdate.h"
#include "semantic_topo_loop/TrackingReport.h"
#include "semantic_topo_loop/frontend/rgbd_frontend.h"
#include "semantic_topo_loop/types/detection.h"
#include "semantic_topo_loop/types/frame.h"
#include "semantic_topo_loop/types/landmark.h"
#include "semantic_topo_loop/types/loop_closure.h"
#include "semantic_topo_loop/types/map_correction.h"

/// Core types to messages and back, bit for bit: no number is rounded or normalised, so that the chain over topics
/// computes the bytes of the chain in one process. `to_msg(value, message)` leaves the header and session_id to the
/// caller unless said otherwise. `from_msg` trusts its message; what comes from outside goes through `checked_*`.
namespace semantic_topo_loop {

/// @param stamp_ns clamped to what ros::Time can hold: [0, 2^32) s
ros::Time to_ros_time(std::int64_t stamp_ns);
std::int64_t to_stamp_ns(const ros::Time& time);
/// tf2 refuses frame ids with a leading '/', tf allowed them.
std::string strip_leading_slash(const std::string& frame_id);

geometry_msgs::Vector3 to_vector_msg(const core::Vec3& v);
core::Vec3 from_msg(const geometry_msgs::Vector3& message);
geometry_msgs::Point to_point_msg(const core::Vec3& p);
core::Vec3 from_msg(const geometry_msgs::Point& message);
geometry_msgs::Pose to_msg(const core::SE3& T);
core::SE3 from_msg(const geometry_msgs::Pose& message);
Box to_msg(const core::Box& box);
core::Box from_msg(const Box& message);
Detection to_msg(const core::Detection& detection);
core::Detection from_msg(const Detection& message);

/// Fills size, K, D (plumb_bob), R = I and P = [K 0].
void to_msg(const core::Camera& camera, sensor_msgs::CameraInfo* message);
core::Camera from_msg(const sensor_msgs::CameraInfo& message);
/// @param points camera frame, m; stored as float32 x, y, z
void to_msg(const std::vector<core::Vec3>& points, sensor_msgs::PointCloud2* message);
/// Points with a non-finite coordinate are left out.
/// @return nullopt, naming the field, if x, y or z is missing or not float32, or the data is too short
std::optional<std::vector<core::Vec3>> from_msg(const sensor_msgs::PointCloud2& message, std::string* error);

/// Fills all but session_id, header.frame_id and camera_frame; header.stamp is the frame's.
void to_msg(const core::Frame& frame, Frame* message);
core::Frame from_msg(const Frame& message);
/// Fills all but session_id and header.frame_id.
void to_msg(const core::Frame& keyframe, Keyframe* message);

void to_msg(const std::vector<core::Detection>& detections, DetectionArray* message);
std::vector<core::Detection> from_msg(const DetectionArray& message);
Association to_msg(const core::Association& association);
core::Association from_msg(const Association& message);
void to_msg(const core::AssociationFrame& associations, AssociationArray* message);
core::AssociationFrame from_msg(const AssociationArray& message);

QuadricMerge to_msg(const core::LandmarkMerge& merge);
core::LandmarkMerge from_msg(const QuadricMerge& message);
Quadric to_msg(const core::Landmark& landmark);
core::Landmark from_msg(const Quadric& message);
void to_msg(const core::MapUpdate& update, QuadricMapUpdate* message);
core::MapUpdate from_msg(const QuadricMapUpdate& message);
std::vector<Quadric> to_msg(const std::vector<core::Landmark>& landmarks);
/// The full map as an update of every landmark; `base_version`, what it follows, is left to the holder (MapFollower).
core::MapUpdate from_msg(const QuadricMap& message);

ObjectMatch to_msg(const core::ObjectMatch& match);
core::ObjectMatch from_msg(const ObjectMatch& message);
LoopClosure to_msg(const core::LoopClosure& loop);
core::LoopClosure from_msg(const LoopClosure& message);
void to_msg(const std::vector<core::LoopClosure>& loops, LoopClosureArray* message);
std::vector<core::LoopClosure> from_msg(const LoopClosureArray& message);
KeyframePose to_msg(const core::KeyframePose& keyframe);
core::KeyframePose from_msg(const KeyframePose& message);
LoopVerdict to_msg(const core::LoopVerdict& verdict);
core::LoopVerdict from_msg(const LoopVerdict& message);
OdometryFault to_msg(const core::OdometryFault& fault);
core::OdometryFault from_msg(const OdometryFault& message);
OdometryReport to_msg(const core::OdometryReport& report);
core::OdometryReport from_msg(const OdometryReport& message);
void to_msg(const core::MapCorrection& correction, MapCorrection* message);
core::MapCorrection from_msg(const MapCorrection& message);

void to_msg(const core::TrackingReport& report, TrackingReport* message);
core::TrackingReport from_msg(const TrackingReport& message);

/// A pose from outside: finite, and a quaternion of norm 1 within 1 %, which is then normalised.
/// @return nullopt, with `field`'s component and its value in `error`
std::optional<core::SE3> checked_pose(const geometry_msgs::Pose& message, const std::string& field, std::string* error);
/// A calibration from outside: plumb_bob or no distortion model, at most 5 coefficients, Camera::is_valid.
std::optional<core::Camera> checked_camera(const sensor_msgs::CameraInfo& message, std::string* error);
/// A detection from outside: score finite and in [0, 1], box finite with x1 < x2 and y1 < y2.
std::optional<core::Detection> checked_detection(const Detection& message, std::string* error);

}  // namespace semantic_topo_loop
