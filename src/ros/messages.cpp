#include "semantic_topo_loop/ros/messages.h"

#include <algorithm>
#include <atomic>
#include <memory>

#include "io/map_tables.h"
#include "ros/conversions.h"

namespace semantic_topo_loop {
namespace {

std::atomic<std::uint64_t> decoded{0};

}  // namespace

std::uint64_t decoded_frames() { return decoded; }

namespace wire {

void FrameSensors::take_from(const FrameMessage& frame) {
  to_msg(frame.camera, &camera);
  camera.header = points.header = make_header(frame.header.stamp, frame.camera_frame);
  has_points = frame.points_camera != nullptr;
  if (has_points) to_cloud(*frame.points_camera, &points);
  if (frame.features) features = *frame.features;
}

void FrameSensors::give_to(FrameMessage* frame) const {
  ++decoded;
  frame->stamp_ns = to_stamp_ns(frame->header.stamp);
  frame->camera = from_msg(camera);
  const auto is_finite = [](const core::PointFeature& feature) { return feature.position.allFinite(); };
  if (!features.empty() && std::all_of(features.begin(), features.end(), is_finite)) {
    frame->features = std::make_shared<const std::vector<core::PointFeature>>(features);
  }
  if (!has_points) return;
  core::Result<std::vector<core::Vec3>> read = from_msg(points);
  if (read) frame->points_camera = std::make_shared<const std::vector<core::Vec3>>(*std::move(read));
}

void KeyframeClouds::take_from(const KeyframePointsMessage& keyframe) {
  sparse.header = semi_dense.header = make_header(keyframe.header.stamp, keyframe.header.frame_id);
  if (!keyframe.keyframe_points) return;
  std::vector<Eigen::Vector3f> points;
  for (const core::SparsePoint& point : keyframe.keyframe_points->sparse) {
    sparse_ids.push_back(point.id);
    points.push_back(point.point_camera);
  }
  to_cloud(points, &sparse);
  to_cloud(keyframe.keyframe_points->semi_dense, &semi_dense);
}

void KeyframeClouds::give_to(KeyframePointsMessage* keyframe) const {
  keyframe->stamp_ns = to_stamp_ns(keyframe->header.stamp);
  keyframe->is_keyframe = true;
  const auto sparse_points = from_msg(sparse), semi_dense_points = from_msg(semi_dense);
  if (!sparse_points || !semi_dense_points) {
    keyframe->problem = (sparse_points ? semi_dense_points : sparse_points).message();
    return;
  }
  if (sparse_points->size() != sparse_ids.size()) {
    keyframe->problem = std::to_string(sparse_ids.size()) + " sparse_ids for " + std::to_string(sparse_points->size()) +
                        " finite points of sparse";
    return;
  }
  auto points = std::make_shared<core::KeyframePoints>();
  for (std::size_t i = 0; i < sparse_ids.size(); ++i) {
    points->sparse.push_back({sparse_ids[i], (*sparse_points)[i].cast<float>()});
  }
  for (const core::Vec3& point : *semi_dense_points) points->semi_dense.push_back(point.cast<float>());
  keyframe->keyframe_points = std::move(points);
}

void MapBody::take_from(const MapPartMessage& part) {
  if (part.delta) bytes = core::pack(*part.delta);
}

void MapBody::give_to(MapPartMessage* part) const { part->delta = core::unpack_map_delta(bytes); }

}  // namespace wire
}  // namespace semantic_topo_loop
