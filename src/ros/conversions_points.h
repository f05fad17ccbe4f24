#pragma once

#include <sensor_msgs/PointCloud2.h>

#include <optional>
#include <string>
#include <vector>

#include "semantic_topo_loop/KeyframePoints.h"
#include "semantic_topo_loop/types/frame.h"

namespace semantic_topo_loop {

/// Fills all but the headers' frame_id and session_id. @param keyframe has keyframe_points
void to_msg(const core::Frame& keyframe, KeyframePoints* message);
/// @return a keyframe of which only id, stamp, pose and points are known; nullopt, with field and value in `error`, if
/// a cloud is none, or there is not one id for each sparse point
std::optional<core::Frame> from_msg(const KeyframePoints& message, std::string* error);
/// As float32 x, y, z.
void to_cloud(const std::vector<Eigen::Vector3f>& points, sensor_msgs::PointCloud2* message);

}  // namespace semantic_topo_loop
