#pragma once

#include <sensor_msgs/Image.h>

#include <optional>
#include <string>

#include "semantic_topo_loop/frontend/rgbd_image.h"

namespace semantic_topo_loop {

/// A colour image and its depth as the front end takes them: every colour encoding of cv_bridge, Bayer patterns and
/// mono8 included, and depth as 32FC1 (metres), 16UC1 or mono16. The stamp is the colour image's.
/// @return nullopt, with topic and value in `error`, for an encoding or size that cannot be used
std::optional<core::RgbdImage> make_rgbd_image(const sensor_msgs::Image& color, const sensor_msgs::Image& depth,
                                               const core::Camera& camera, const core::DepthOptions& options,
                                               std::string* error);

}  // namespace semantic_topo_loop
