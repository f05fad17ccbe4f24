#pragma once

#include <opencv2/core.hpp>
#include <optional>

#include "ros/map_view.h"
#include "semantic_topo_loop/geometry/quadric.h"
#include "semantic_topo_loop/types/class_table.h"

namespace semantic_topo_loop {

/// The ellipse of a dual conic, px: pixel centres have whole coordinates.   @return nullopt if it is none
std::optional<cv::RotatedRect> ellipse_of(const core::Conic& C_dual_image);

/// Draws what a frame has seen: its detections with class and landmark id, grey where they have no landmark, and the
/// confirmed objects as the map has them, projected into the image; thick those that were detected.
/// @param view the map; ids that it has merged are drawn as their survivors
/// @param image BGR, of the size of frame.camera, raw; undistorted on return, so that ellipsoids are ellipses
/// @return an error that names the sizes if they differ
core::Status annotate(const core::Frame& frame, const core::AssociationFrame& associations, const MapView& view,
                      const core::ClassTable& classes, cv::Mat* image);

}  // namespace semantic_topo_loop
