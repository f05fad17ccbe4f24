#include <sensor_msgs/distortion_models.h>
#include <sensor_msgs/point_cloud2_iterator.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>
#include <utility>

#include "semantic_topo_loop/ros/conversions.h"

// Time, geometry, cameras and clouds, and the checks of what comes from outside.
namespace semantic_topo_loop {
namespace {

constexpr std::int64_t kNsPerS = 1000000000;

/// @return false with "<field> = <value> <rule>" in `error`
bool fail(const std::string& field, double value, const std::string& rule, std::string* error) {
  std::ostringstream text;
  text << field << " = " << value << " " << rule;
  if (error != nullptr) *error = text.str();
  return false;
}

bool is_finite(const std::string& field, double value, std::string* error) {
  return std::isfinite(value) || fail(field, value, "is not finite", error);
}

/// The cloud's x, y and z are float32 and its data is as long as its size says.
bool has_xyz(const sensor_msgs::PointCloud2& message, std::string* error) {
  for (const char* name : {"x", "y", "z"}) {
    const auto field = std::find_if(message.fields.begin(), message.fields.end(),
                                    [name](const sensor_msgs::PointField& f) { return f.name == name; });
    const bool usable = field != message.fields.end() && field->datatype == sensor_msgs::PointField::FLOAT32 &&
                        std::uint64_t{field->offset} + sizeof(float) <= message.point_step;
    if (usable) continue;
    if (error != nullptr) *error = std::string("point cloud field '") + name + "' is missing or not float32";
    return false;
  }
  const std::uint64_t expected = std::uint64_t{message.width} * message.height * message.point_step;
  if (message.data.size() == expected) return true;
  return fail("point cloud data size", static_cast<double>(message.data.size()),
              "is not width * height * point_step = " + std::to_string(expected), error);
}

}  // namespace

void to_msg(const core::TrackingReport& report, TrackingReport* message) {
  message->images = report.images;
  message->tracked = report.tracked;
  message->relocalised = report.relocalised;
  message->restarts = report.restarts;
  message->lost = report.lost;
  message->unusable = report.unusable;
  message->unreadable = report.unreadable;
  message->first_unreadable = report.first_unreadable;
}

core::TrackingReport from_msg(const TrackingReport& message) {
  core::TrackingReport report;
  report.images = message.images;
  report.tracked = message.tracked;
  report.relocalised = message.relocalised;
  report.restarts = message.restarts;
  report.lost = message.lost;
  report.unusable = message.unusable;
  report.unreadable = message.unreadable;
  report.first_unreadable = message.first_unreadable;
  return report;
}

ros::Time to_ros_time(std::int64_t stamp_ns) {
  constexpr std::int64_t kMax = (std::int64_t{std::numeric_limits<std::uint32_t>::max()} + 1) * kNsPerS - 1;
  const std::int64_t ns = std::clamp<std::int64_t>(stamp_ns, 0, kMax);
  return {static_cast<std::uint32_t>(ns / kNsPerS), static_cast<std::uint32_t>(ns % kNsPerS)};
}

std::int64_t to_stamp_ns(const ros::Time& time) { return std::int64_t{time.sec} * kNsPerS + std::int64_t{time.nsec}; }

std::string strip_leading_slash(const std::string& frame_id) {
  return frame_id.empty() || frame_id.front() != '/' ? frame_id : frame_id.substr(1);
}

geometry_msgs::Vector3 to_vector_msg(const core::Vec3& v) {
  geometry_msgs::Vector3 message;
  message.x = v.x();
  message.y = v.y();
  message.z = v.z();
  return message;
}

core::Vec3 from_msg(const geometry_msgs::Vector3& message) { return {message.x, message.y, message.z}; }

geometry_msgs::Point to_point_msg(const core::Vec3& p) {
  geometry_msgs::Point message;
  message.x = p.x();
  message.y = p.y();
  message.z = p.z();
  return message;
}

core::Vec3 from_msg(const geometry_msgs::Point& message) { return {message.x, message.y, message.z}; }

geometry_msgs::Pose to_msg(const core::SE3& T) {
  geometry_msgs::Pose message;
  message.position = to_point_msg(T.t);
  message.orientation.x = T.q.x();
  message.orientation.y = T.q.y();
  message.orientation.z = T.q.z();
  message.orientation.w = T.q.w();
  return message;
}

core::SE3 from_msg(const geometry_msgs::Pose& message) {
  const geometry_msgs::Quaternion& q = message.orientation;
  return {core::Quaternion(q.w, q.x, q.y, q.z), from_msg(message.position)};
}

Box to_msg(const core::Box& box) {
  Box message;
  message.x1 = box.x1;
  message.y1 = box.y1;
  message.x2 = box.x2;
  message.y2 = box.y2;
  return message;
}

core::Box from_msg(const Box& message) { return {message.x1, message.y1, message.x2, message.y2}; }

Detection to_msg(const core::Detection& detection) {
  Detection message;
  message.class_id = detection.class_id;
  message.score = detection.score;
  message.box = to_msg(detection.box);
  return message;
}

core::Detection from_msg(const Detection& message) { return {message.class_id, message.score, from_msg(message.box)}; }

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
  camera.fx = message.K[0];
  camera.cx = message.K[2];
  camera.fy = message.K[4];
  camera.cy = message.K[5];
  camera.width = static_cast<int>(message.width);
  camera.height = static_cast<int>(message.height);
  const auto coefficients = static_cast<std::ptrdiff_t>(std::min(message.D.size(), camera.distortion.size()));
  std::copy_n(message.D.begin(), coefficients, camera.distortion.begin());
  return camera;
}

void to_msg(const std::vector<core::Vec3>& points, sensor_msgs::PointCloud2* message) {
  sensor_msgs::PointCloud2Modifier modifier(*message);
  modifier.setPointCloud2FieldsByString(1, "xyz");
  modifier.resize(points.size());
  message->is_dense = true;
  sensor_msgs::PointCloud2Iterator<float> it(*message, "x");
  for (const core::Vec3& p : points) {
    for (int i = 0; i < 3; ++i) it[i] = static_cast<float>(p[i]);
    ++it;
  }
}

std::optional<std::vector<core::Vec3>> from_msg(const sensor_msgs::PointCloud2& message, std::string* error) {
  if (!has_xyz(message, error)) return std::nullopt;
  std::vector<core::Vec3> points;
  points.reserve(std::size_t{message.width} * message.height);
  sensor_msgs::PointCloud2ConstIterator<float> x(message, "x"), y(message, "y"), z(message, "z");
  for (; x != x.end(); ++x, ++y, ++z) {
    const core::Vec3 p = Eigen::Vector3f(*x, *y, *z).cast<double>();
    if (p.allFinite()) points.push_back(p);
  }
  return points;
}

std::optional<core::SE3> checked_pose(const geometry_msgs::Pose& message, const std::string& field,
                                      std::string* error) {
  const geometry_msgs::Point& p = message.position;
  const geometry_msgs::Quaternion& q = message.orientation;
  for (const auto& [name, value] :
       {std::pair(".position.x", p.x), std::pair(".position.y", p.y), std::pair(".position.z", p.z),
        std::pair(".orientation.x", q.x), std::pair(".orientation.y", q.y), std::pair(".orientation.z", q.z),
        std::pair(".orientation.w", q.w)}) {
    if (!is_finite(field + name, value, error)) return std::nullopt;
  }
  core::SE3 T = from_msg(message);
  constexpr double kNormTolerance = 0.01;
  const double norm = T.q.norm();
  if (std::abs(norm - 1.0) > kNormTolerance) {
    fail(field + ".orientation norm", norm, "is not 1", error);
    return std::nullopt;
  }
  T.q.normalize();
  return T;
}

std::optional<core::Camera> checked_camera(const sensor_msgs::CameraInfo& message, std::string* error) {
  const bool known_model =
      message.distortion_model.empty() || message.distortion_model == sensor_msgs::distortion_models::PLUMB_BOB;
  if (!known_model || message.D.size() > 5) {
    if (error != nullptr) {
      *error = "camera_info distortion_model = '" + message.distortion_model + "' with " +
               std::to_string(message.D.size()) + " coefficients is not plumb_bob with at most 5";
    }
    return std::nullopt;
  }
  const core::Camera camera = from_msg(message);
  const core::Status status = camera.check();
  if (status) return camera;
  if (error != nullptr) *error = "camera_info " + status.message();
  return std::nullopt;
}

std::optional<core::Detection> checked_detection(const Detection& message, std::string* error) {
  const Box& box = message.box;
  for (const auto& [name, value] :
       {std::pair("score", message.score), std::pair("box.x1", box.x1), std::pair("box.y1", box.y1),
        std::pair("box.x2", box.x2), std::pair("box.y2", box.y2)}) {
    if (!is_finite(name, value, error)) return std::nullopt;
  }
  if (message.score < 0.0 || message.score > 1.0) {
    fail("score", message.score, "is not in [0, 1]", error);
    return std::nullopt;
  }
  if (box.x2 <= box.x1) {
    fail("box.x2", box.x2, "is not greater than x1", error);
    return std::nullopt;
  }
  if (box.y2 <= box.y1) {
    fail("box.y2", box.y2, "is not greater than y1", error);
    return std::nullopt;
  }
  return from_msg(message);
}

}  // namespace semantic_topo_loop
