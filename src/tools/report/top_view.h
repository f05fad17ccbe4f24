#pragma once

#include <cstdint>
#include <map>
#include <string>

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

/// Whether nothing is known of what was between two stamps, so that no line leads from one to the other.
inline bool is_gap(std::int64_t before_ns, std::int64_t after_ns) {
  constexpr std::int64_t kMax_ns = 1'000'000'000;
  return after_ns - before_ns > kMax_ns;
}

/// A color a class, by its label.
using ClassColors = std::map<std::string, std::string>;
ClassColors class_colors(const RunData& run);

/// Of odometry, live or optimised.
std::string trajectory_color(const std::string& name);

/// All trajectories, and the ground truth. An SVG element with its legend.
std::string draw_trajectories(const RunData& run, const TopView& view);

/// Confirmed objects, as the ellipses that their ellipsoids are from above, and reference objects.
std::string draw_objects(const RunData& run, const TopView& view, const ClassColors& colors);

}  // namespace semantic_topo_loop::core
