#pragma once

#include <geometry_msgs/Point.h>
#include <geometry_msgs/Pose.h>
#include <geometry_msgs/TransformStamped.h>
#include <ros/time.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/PointCloud2.h>
#include <std_msgs/Header.h>

#include <cstdint>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/camera.h"
#include "semantic_topo_loop/types/result.h"
#include "semantic_topo_loop/types/transform.h"

/// Time, geometry, cameras and clouds between the core and the messages of ROS, bit for bit: no number is rounded or
/// normalised but a cloud's coordinates, which are float32. `from_msg` trusts the numbers of its message; what comes
/// from outside goes through `checked_*`. The package's own messages need no conversion: see ros/messages.h.
namespace semantic_topo_loop {

/// How far apart the stamps of an image and of its detections or recorded pose may be: they are one stamp, written with
/// six decimals.
constexpr std::int64_t kStampTolerance_ns = 1000;
/// A stamp this far behind the newest one says that time has jumped back, as when a bag is played anew; one that is
/// less far behind is a late message.
constexpr std::int64_t kJumpBack_ns = 1'000'000'000;

/// @param stamp_ns clamped to what ros::Time can hold: [0, 2^32) s
ros::Time to_ros_time(std::int64_t stamp_ns);
std::int64_t to_stamp_ns(const ros::Time& time);
/// Of `n` things every so manieth is shown, so that at most `most` are: a power of two, so that what is shown stays.
inline std::size_t thinning(std::size_t n, std::size_t most) {
  std::size_t step = 1;
  while (n > most * step) step *= 2;
  return step;
}
std_msgs::Header make_header(const ros::Time& stamp, const std::string& frame_id);
/// tf2 refuses frame ids with a leading '/', tf allowed them.
std::string strip_leading_slash(const std::string& frame_id);

/// @tparam Message geometry_msgs::Vector3 or Point
template <class Message>
Message to_xyz(const core::Vec3& v) {
  Message message;
  message.x = v.x();
  message.y = v.y();
  message.z = v.z();
  return message;
}
geometry_msgs::Pose to_msg(const core::SE3& T);
/// @param header with the parent's frame id
geometry_msgs::TransformStamped make_transform(const std_msgs::Header& header, const std::string& child,
                                               const core::SE3& T_parent_child);
core::SE3 from_msg(const geometry_msgs::Pose& message);

/// Fills size, K, D (plumb_bob), R = I and P = [K 0].
void to_msg(const core::Camera& camera, sensor_msgs::CameraInfo* message);
core::Camera from_msg(const sensor_msgs::CameraInfo& message);

/// As float32 x, y, z; leaves the header as it is. @tparam Point core::Vec3 or Eigen::Vector3f
template <class Point>
void to_cloud(const std::vector<Point>& points, sensor_msgs::PointCloud2* message);
/// The finite points. @return an error that names field and value if x, y or z is missing or not float32
core::Result<std::vector<core::Vec3>> from_msg(const sensor_msgs::PointCloud2& message);

/// A pose from outside: finite, and a quaternion of norm 1 within 1 %, which is then normalised.
/// @return an error that names `field`'s component and its value
core::Result<core::SE3> checked_pose(const geometry_msgs::Pose& message, const std::string& field);
/// A calibration from outside: plumb_bob or no distortion model, at most 5 coefficients, Camera::check, as at most
/// 10000 pixels a side.
core::Result<core::Camera> checked_camera(const sensor_msgs::CameraInfo& message);

}  // namespace semantic_topo_loop
