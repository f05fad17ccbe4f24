#pragma once

#include <map>
#include <string>
#include <vector>

#include "semantic_topo_loop/types/transform.h"
#include "tools/report/chart.h"
#include "tools/report/run_data.h"

namespace semantic_topo_loop::core {

/// Where up is in the world that a run is shown in, and what is seen from above.
struct TopView {
  Mat3 R_view_world = Mat3::Identity();  ///< z of the view is up
  bool is_certain = true;                ///< up is known: from the ground truth, or by how the camera turned

  Vec2 operator()(const Vec3& point_world) const { return (R_view_world * point_world).head<2>(); }
};

/// The z axis of the ground truth's world, else what the optimised poses of a camera held without roll say of it.
TopView top_view(const RunData& run);

/// A color a class, by its label.
using ClassColors = std::map<std::string, std::string>;
ClassColors class_colors(const RunData& run);

/// Of odometry, live or optimised.
std::string trajectory_color(const std::string& name);

/// All trajectories, and the ground truth. An SVG element with its legend.
std::string draw_trajectories(const RunData& run, const TopView& view);

/// Confirmed objects, as the ellipses that their ellipsoids are from above, and reference objects.
std::string draw_objects(const RunData& run, const TopView& view, const ClassColors& colors);

/// The two submaps of a loop side by side, as they were, turned alike; lines join what was matched; on the right both
/// on top of each other, as the loop says. The cameras look along their arrows.
/// @param loop with objects
std::string draw_loop(const RunData& run, const ShownLoop& loop, const TopView& view, const ClassColors& colors);

}  // namespace semantic_topo_loop::core
