#include "ros/conversions.h"

#include <sensor_msgs/distortion_models.h>
#include <sensor_msgs/point_cloud2_iterator.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "semantic_topo_loop/types/text.h"

namespace semantic_topo_loop {
namespace {

constexpr std::int64_t kNsPerS = 1000000000;

/// "<field> = <value> <rule>"
core::Error bad(const std::string& field, double value, const std::string& rule) {
  return {field + " = " + core::format_general(value, 6) + " " + rule};
}

/// The cloud's x, y and z are float32 and its data is as long as its size says.
core::Status check_xyz(const sensor_msgs::PointCloud2& message) {
  for (const char* name : {"x", "y", "z"}) {
    const auto field = std::find_if(message.fields.begin(), message.fields.end(),
                                    [name](const sensor_msgs::PointField& f) { return f.name == name; });
    const bool usable = field != message.fields.end() && field->datatype == sensor_msgs::PointField::FLOAT32 &&
                        std::uint64_t{field->offset} + sizeof(float) <= message.point_step;
    if (!usable) return core::Error{std::string("point cloud field '") + name + "' is missing or not float32"};
  }
  const std::uint64_t points = std::uint64_t{message.width} * message.height;
  // Three sizes may have a product beyond 64 bits.
  if (message.data.size() / message.point_step == points && message.data.size() % message.point_step == 0) return {};
  const std::uint64_t expected = points * message.point_step;
  return bad("point cloud data size", static_cast<double>(message.data.size()),
             "is not width * height * point_step = " + std::to_string(expected));
}

}  // namespace

template <class Point>
void to_cloud(const std::vector<Point>& points, sensor_msgs::PointCloud2* message) {
  sensor_msgs::PointCloud2Modifier modifier(*message);
  modifier.setPointCloud2FieldsByString(1, "xyz");
  modifier.resize(points.size());
  message->is_dense = true;
  sensor_msgs::PointCloud2Iterator<float> it(*message, "x");
  for (const Point& p : points) {
    for (int i = 0; i < 3; ++i) it[i] = static_cast<float>(p[i]);
    ++it;
  }
}
template void to_cloud(const std::vector<core::Vec3>& points, sensor_msgs::PointCloud2* message);
template void to_cloud(const std::vector<Eigen::Vector3f>& points, sensor_msgs::PointCloud2* message);

ros::Time to_ros_time(std::int64_t stamp_ns) {
  constexpr std::int64_t kMax = (std::int64_t{std::numeric_limits<std::uint32_t>::max()} + 1) * kNsPerS - 1;
  const std::int64_t ns = std::clamp<std::int64_t>(stamp_ns, 0, kMax);
  return {static_cast<std::uint32_t>(ns / kNsPerS), static_cast<std::uint32_t>(ns % kNsPerS)};
}

std::int64_t to_stamp_ns(const ros::Time& time) { return std::int64_t{time.sec} * kNsPerS + std::int64_t{time.nsec}; }

std_msgs::Header make_header(const ros::Time& stamp, const std::string& frame_id) {
  std_msgs::Header header;
  header.stamp = stamp;
  header.frame_id = frame_id;
  return header;
}

std::string strip_leading_slash(const std::string& frame_id) {
  return frame_id.empty() || frame_id.front() != '/' ? frame_id : frame_id.substr(1);
}

geometry_msgs::Pose to_msg(const core::SE3& T) {
  geometry_msgs::Pose message;
  message.position = to_xyz<geometry_msgs::Point>(T.t);
  message.orientation.x = T.q.x();
  message.orientation.y = T.q.y();
  message.orientation.z = T.q.z();
  message.orientation.w = T.q.w();
  return message;
}

geometry_msgs::TransformStamped make_transform(const std_msgs::Header& header, const std::string& child,
                                               const core::SE3& T_parent_child) {
  geometry_msgs::TransformStamped message;
  message.header = header;
  message.child_frame_id = child;
  message.transform.translation = to_xyz<geometry_msgs::Vector3>(T_parent_child.t);
  message.transform.rotation = to_msg(T_parent_child).orientation;
  return message;
}

core::SE3 from_msg(const geometry_msgs::Pose& message) {
  const geometry_msgs::Point& p = message.position;
  const geometry_msgs::Quaternion& q = message.orientation;
  return {core::Quaternion(q.w, q.x, q.y, q.z), core::Vec3(p.x, p.y, p.z)};
}

void to_msg(const core::Camera& camera, sensor_msgs::CameraInfo* message) {
  message->width = static_cast<std::uint32_t>(camera.width);
  message->height = static_cast<std::uint32_t>(camera.height);
  message->distortion_model = sensor_msgs::distortion_models::PLUMB_BOB;
  message->D.assign(camera.distortion.begin(), camera.distortion.end());
  message->K = {camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0};
  message->R = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
  message->P = {camera.fx, 0.0, camera.cx, 0.0, 0.0, camera.fy, camera.cy, 0.0, 0.0, 0.0, 1.0, 0.0};
}

core::Camera from_msg(const sensor_msgs::CameraInfo& message) {
  core::Camera camera;
  // K, width and height are those of the whole sensor; the image is a part of it, or binned.
  const std::uint32_t binning_x = std::max(1U, message.binning_x), binning_y = std::max(1U, message.binning_y);
  camera.fx = message.K[0] / binning_x;
  camera.cx = (message.K[2] - message.roi.x_offset) / binning_x;
  camera.fy = message.K[4] / binning_y;
  camera.cy = (message.K[5] - message.roi.y_offset) / binning_y;
  camera.width = static_cast<int>((message.roi.width > 0 ? message.roi.width : message.width) / binning_x);
  camera.height = static_cast<int>((message.roi.height > 0 ? message.roi.height : message.height) / binning_y);
  const auto coefficients = static_cast<std::ptrdiff_t>(std::min(message.D.size(), camera.distortion.size()));
  std::copy_n(message.D.begin(), coefficients, camera.distortion.begin());
  return camera;
}

core::Result<std::vector<core::Vec3>> from_msg(const sensor_msgs::PointCloud2& message) {
  if (const core::Status status = check_xyz(message); !status) return status.error();
  std::vector<core::Vec3> points;
  points.reserve(std::size_t{message.width} * message.height);
  sensor_msgs::PointCloud2ConstIterator<float> x(message, "x"), y(message, "y"), z(message, "z");
  for (; x != x.end(); ++x, ++y, ++z) {
    const core::Vec3 p = Eigen::Vector3f(*x, *y, *z).cast<double>();
    if (p.allFinite()) points.push_back(p);
  }
  return points;
}

core::Result<core::SE3> checked_pose(const geometry_msgs::Pose& message, const std::string& field) {
  const geometry_msgs::Point& p = message.position;
  const geometry_msgs::Quaternion& q = message.orientation;
  for (const auto& [name, value] :
       {std::pair(".position.x", p.x), std::pair(".position.y", p.y), std::pair(".position.z", p.z),
        std::pair(".orientation.x", q.x), std::pair(".orientation.y", q.y), std::pair(".orientation.z", q.z),
        std::pair(".orientation.w", q.w)}) {
    if (!std::isfinite(value)) return bad(field + name, value, "is not finite");
  }
  core::SE3 T = from_msg(message);
  if (!core::is_rotation(T.q)) return bad(field + ".orientation norm", T.q.norm(), "is not 1");
  T.q.normalize();
  return T;
}

core::Result<core::Camera> checked_camera(const sensor_msgs::CameraInfo& message) {
  const bool known_model =
      message.distortion_model.empty() || message.distortion_model == sensor_msgs::distortion_models::PLUMB_BOB;
  if (!known_model || message.D.size() > 5) {
    return core::Error{
        "camera_info distortion_model = '" + message.distortion_model + "' with " + std::to_string(message.D.size()) +
        " coefficients is not plumb_bob with at most 5: rectified images are needed (image_proc), with a "
        "calibration that holds fx, fy, cx, cy of their P and no distortion"};
  }
  const core::Camera camera = from_msg(message);
  if (const core::Status status = camera.check(); !status) return core::Error{"camera_info " + status.message()};
  return camera;
}

}  // namespace semantic_topo_loop
