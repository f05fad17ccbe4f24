#include "ros/conversions_points.h"

#include <sensor_msgs/point_cloud2_iterator.h>

#include <memory>
#include <utility>

#include "semantic_topo_loop/ros/conversions.h"

namespace semantic_topo_loop {
namespace {

std::optional<std::vector<Eigen::Vector3f>> points_of(const sensor_msgs::PointCloud2& message, std::string* error) {
  const std::optional<std::vector<core::Vec3>> points = from_msg(message, error);
  if (!points) return std::nullopt;
  std::vector<Eigen::Vector3f> result;
  result.reserve(points->size());
  for (const core::Vec3& point : *points) result.push_back(point.cast<float>());
  return result;
}

}  // namespace

void to_cloud(const std::vector<Eigen::Vector3f>& points, sensor_msgs::PointCloud2* message) {
  sensor_msgs::PointCloud2Modifier modifier(*message);
  modifier.setPointCloud2FieldsByString(1, "xyz");
  modifier.resize(points.size());
  message->is_dense = 1;
  sensor_msgs::PointCloud2Iterator<float> it(*message, "x");
  for (const Eigen::Vector3f& p : points) {
    for (int i = 0; i < 3; ++i) it[i] = p[i];
    ++it;
  }
}

void to_msg(const core::Frame& keyframe, KeyframePoints* message) {
  message->header.stamp = to_ros_time(keyframe.stamp_ns);
  message->keyframe_id = keyframe.keyframe_id;
  message->odom_from_camera = to_msg(keyframe.T_odom_camera);
  std::vector<Eigen::Vector3f> sparse;
  for (const core::SparsePoint& point : keyframe.keyframe_points->sparse) {
    message->sparse_ids.push_back(point.id);
    sparse.push_back(point.point_camera);
  }
  to_cloud(sparse, &message->sparse);
  to_cloud(keyframe.keyframe_points->semi_dense, &message->semi_dense);
  message->sparse.header.stamp = message->semi_dense.header.stamp = message->header.stamp;
}

std::optional<core::Frame> from_msg(const KeyframePoints& message, std::string* error) {
  const std::optional<std::vector<Eigen::Vector3f>> sparse = points_of(message.sparse, error);
  if (!sparse) return std::nullopt;
  std::optional<std::vector<Eigen::Vector3f>> semi_dense = points_of(message.semi_dense, error);
  if (!semi_dense) return std::nullopt;
  if (sparse->size() != message.sparse_ids.size()) {
    if (error != nullptr) {
      *error = std::to_string(message.sparse_ids.size()) + " sparse_ids for " + std::to_string(sparse->size()) +
               " finite points of sparse";
    }
    return std::nullopt;
  }
  core::KeyframePoints points;
  for (std::size_t i = 0; i < sparse->size(); ++i) points.sparse.push_back({message.sparse_ids[i], (*sparse)[i]});
  points.semi_dense = std::move(*semi_dense);
  core::Frame frame;
  frame.stamp_ns = to_stamp_ns(message.header.stamp);
  frame.keyframe_id = message.keyframe_id;
  frame.is_keyframe = true;
  frame.T_odom_camera = from_msg(message.odom_from_camera);
  frame.keyframe_points = std::make_shared<const core::KeyframePoints>(std::move(points));
  return frame;
}

}  // namespace semantic_topo_loop
