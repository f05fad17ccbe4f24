#pragma once

#include <std_msgs/ColorRGBA.h>
#include <visualization_msgs/MarkerArray.h>

#include <boost/make_shared.hpp>

#include "ros/map_view.h"
#include "ros/parameters.h"
#include "semantic_topo_loop/LoopMap.h"
#include "semantic_topo_loop/types/class_table.h"

/// What rviz shows of the map. Each MarkerArray begins with DELETEALL; ids are those of landmarks, so a marker keeps
/// its id.
namespace semantic_topo_loop {

/// The same colour for a class in every run, neighbours in id far apart in hue.
std_msgs::ColorRGBA class_color(int class_id, double alpha);

/// Ellipsoids: confirmed ones in namespace "quadrics", more opaque with quality; candidates faint in "candidates".
visualization_msgs::MarkerArrayPtr make_quadric_markers(const MapView& view, const std_msgs::Header& header);
/// Class names above the confirmed objects, namespace "labels".
visualization_msgs::MarkerArrayPtr make_label_markers(const MapView& view, const std_msgs::Header& header,
                                                      const core::ClassTable& classes, const MarkerSizes& sizes);
/// Lines between neighbours among the objects of the current view, namespace "topology".
visualization_msgs::MarkerArrayPtr make_topology_markers(const MapView& view, const std_msgs::Header& header,
                                                         const MarkerSizes& sizes);
/// Lines between the keyframes of accepted loops, namespace "loops": green, or thick and red where the optimiser
/// rejected it. Of loops whose ends lie together one is drawn.
visualization_msgs::MarkerArrayPtr make_loop_markers(const MapView& view, const std_msgs::Header& header,
                                                     const MarkerSizes& sizes);
/// The loops with their ends and their objects where they are now; left out are those without one of their keyframes.
LoopMapPtr make_loop_map(const MapView& view, const std_msgs::Header& header, std::uint32_t session_id);
/// Frusta of the keyframes, every so manieth where they are many, and, in another colour, of the current camera,
/// namespace "keyframes".
visualization_msgs::MarkerArrayPtr make_keyframe_markers(const MapView& view, const std_msgs::Header& header,
                                                         const MarkerSizes& sizes);

}  // namespace semantic_topo_loop
