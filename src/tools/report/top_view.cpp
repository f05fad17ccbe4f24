#include "tools/report/top_view.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <set>
#include <utility>

#include "geometry/up_estimator.h"
#include "semantic_topo_loop/types/text.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kWidth_px = 1120.0, kHalfWidth_px = 550.0;
constexpr const char* kTruthColor = "#1f2933";
constexpr const char* kWrongColor = "#e03131";

std::vector<Vec2> from_above(const StampedPoses& poses, const Sim3& S_world_map, const TopView& view) {
  std::vector<Vec2> points;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    if (i > 0 && is_gap(poses[i - 1].stamp_ns, poses[i].stamp_ns)) points.push_back(line_break());
    points.push_back(view(S_world_map * poses[i].T_world_camera.t));
  }
  return points;
}

/// An ellipse as it is seen from above, m.
struct Outline {
  Vec2 center, semi_axes;  ///< the longer axis first
  double angle_deg = 0.0;  ///< of the longer axis, from x to y
  Vec2 reach;              ///< half of the box around it
};

Outline outline(const MappedObject& object, const Sim3& S_world_map, const TopView& view) {
  const Mat3 R = view.R_view_world * (S_world_map.T.q * object.rotation).toRotationMatrix();
  const Vec3 axes = S_world_map.scale * object.semi_axes;
  // The shadow of an ellipsoid is the horizontal block of its dual.
  const Mat3 dual = R * axes.cwiseAbs2().asDiagonal() * R.transpose();
  const Eigen::Matrix2d shadow = dual.topLeftCorner<2, 2>();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> solver(shadow);
  const Vec2 longer = solver.eigenvectors().col(1);
  Outline result;
  result.center = view(S_world_map * object.center);
  result.semi_axes = solver.eigenvalues().cwiseMax(0.0).cwiseSqrt().reverse();
  result.angle_deg = degrees(std::atan2(longer.y(), longer.x()));
  result.reach = shadow.diagonal().cwiseMax(0.0).cwiseSqrt();
  return result;
}

std::string ellipse(const Chart& chart, const Outline& outline, const std::string& attributes,
                    const std::string& tooltip) {
  const Vec2 at = chart.to_px(outline.center), axes = chart.px_per_m() * outline.semi_axes;
  return "<ellipse rx=\"" + px(axes.x()) + "\" ry=\"" + px(axes.y()) + "\" transform=\"translate(" + px(at.x()) + ' ' +
         px(at.y()) + ") rotate(" + px(-outline.angle_deg) + ")\" " + attributes + "><title>" + escaped(tooltip) +
         "</title></ellipse>\n";
}

std::string cross(const Vec2& at, double size, const std::string& color) {
  const std::string stroke = "stroke=\"" + color + "\" stroke-width=\"1.6\"";
  return svg_line(at - Vec2(size, size), at + Vec2(size, size), stroke) +
         svg_line(at - Vec2(size, -size), at + Vec2(size, -size), stroke);
}

}  // namespace

TopView top_view(const RunData& run) {
  if (!run.truth.empty()) return {};
  constexpr double kWhole_s = 1e9;  // longer than a run
  UpEstimator estimator(kWhole_s);
  constexpr std::size_t kPosesMax = 2000;
  const StampedPoses& poses = run.optimised().poses;
  const std::size_t step = poses.size() / kPosesMax + 1;
  for (std::size_t i = 0; i < poses.size(); i += step) {
    Frame frame;
    frame.stamp_ns = poses[i].stamp_ns;
    frame.T_odom_camera = poses[i].T_world_camera;
    estimator.push(frame);
  }
  const UpDirection up = estimator.estimate(Quaternion::Identity());
  // Of the world's axes the one that lies flattest is to the right, as seen from above.
  Eigen::Index flattest = 0;
  up.direction.cwiseAbs().minCoeff(&flattest);
  const Vec3 right = (Vec3::Unit(flattest) - up.direction(flattest) * up.direction).normalized();
  TopView view;
  view.R_view_world << right.transpose(), up.direction.cross(right).transpose(), up.direction.transpose();
  view.is_certain = up.certain;
  return view;
}

std::string trajectory_color(const std::string& name) {
  return name == "optimised" ? "#1864ab" : name == "live" ? "#e8590c" : "#868e96";
}

ClassColors class_colors(const RunData& run) {
  constexpr std::array<const char*, 18> kColors = {"#1c7ed6", "#e8590c", "#2b8a3e", "#9c36b5", "#0c8599", "#a61e4d",
                                                   "#5c940d", "#6741d9", "#b08900", "#8a5a44", "#364fc7", "#c2255c",
                                                   "#087f5b", "#d9480f", "#862e9c", "#1098ad", "#495057", "#e67700"};
  ClassColors colors;
  const auto add = [&](const std::string& label) { colors.emplace(label, kColors[colors.size() % kColors.size()]); };
  for (const MappedObject& object : run.objects) {
    if (object.state == "confirmed") add(object.label);
  }
  for (const ReferenceObject& reference : run.references) add(reference.label);
  for (const ShownLoop& loop : run.loops) {
    for (const auto* side : {&loop.query, &loop.match}) {
      for (const LoopObjectRecord& object : *side) add(object.label);
    }
  }
  return colors;
}

std::string draw_trajectories(const RunData& run, const TopView& view) {
  std::vector<std::pair<std::vector<Vec2>, std::string>> lines;
  std::vector<LegendEntry> entries;
  if (!run.truth.empty()) {
    lines.emplace_back(from_above(run.truth, {}, view), kTruthColor);
    entries.push_back({kTruthColor, "ground truth", LegendEntry::kDash});
  }
  for (const ShownTrajectory& trajectory : run.trajectories) {
    lines.emplace_back(from_above(trajectory.poses, trajectory.S_world_map, view), trajectory_color(trajectory.name));
    entries.push_back({trajectory_color(trajectory.name), trajectory.name});
  }
  Extent extent;
  for (const auto& [points, color] : lines) {
    for (const Vec2& p : points) {
      if (p.allFinite()) extent.add(p);
    }
  }
  Chart chart = Chart::plan(kHalfWidth_px, 0.85, extent);
  for (const auto& [points, color] : lines) {
    const bool is_truth = color == kTruthColor;
    chart.line(
        points, color,
        is_truth ? "stroke-width=\"1\" stroke-dasharray=\"4 3\"" : "stroke-width=\"1.6\" stroke-opacity=\"0.9\"");
  }
  return legend(entries) + chart.svg("trajectories from above");
}

namespace {

/// What the reference objects say: objects that are none, and certain references that were not found.
struct Wrong {
  std::set<std::int64_t> objects;
  std::set<int> references;
};

Wrong find_wrong(const RunData& run) {
  Wrong wrong;
  if (!run.object_evaluation) return wrong;
  for (const ObjectMatchResult& match : run.object_evaluation->matches) {
    if (match.reference_id < 0) wrong.objects.insert(match.object_id);
    if (match.object_id < 0) wrong.references.insert(match.reference_id);
  }
  return wrong;
}

}  // namespace

std::string draw_objects(const RunData& run, const TopView& view, const ClassColors& colors) {
  const ShownTrajectory& trajectory = run.optimised();
  const std::vector<Vec2> path = from_above(trajectory.poses, trajectory.S_world_map, view);
  std::vector<std::pair<Outline, const MappedObject*>> confirmed;
  Extent extent;
  for (const MappedObject& object : run.objects) {
    if (object.state != "confirmed") continue;
    confirmed.emplace_back(outline(object, trajectory.S_world_map, view), &object);
    extent.add(confirmed.back().first.center, confirmed.back().first.reach);
  }
  for (const ReferenceObject& reference : run.references) extent.add(view(reference.center));
  std::stable_sort(confirmed.begin(), confirmed.end(),
                   [](const auto& a, const auto& b) { return a.first.semi_axes.prod() > b.first.semi_axes.prod(); });
  Chart chart = Chart::plan(kWidth_px, 0.62, extent);
  chart.line(path, "#ced4da", "stroke-width=\"1\"");
  const Wrong wrong = find_wrong(run);
  for (const auto& [shape, object] : confirmed) {
    const std::string& color = colors.at(object->label);
    const bool is_wrong = wrong.objects.count(object->id) != 0;
    const std::string stroke = is_wrong ? kWrongColor + std::string("\" stroke-dasharray=\"5 3") : color;
    chart.add(ellipse(chart, shape,
                      "fill=\"" + color + "\" fill-opacity=\"0.18\" stroke=\"" + stroke + "\" stroke-width=\"1.6\"",
                      object->label + " " + std::to_string(object->id)));
  }
  constexpr double kMissed_px = 10.0;
  constexpr std::array<double, 3> kCrossSizes_px = {5.0, 4.0, 3.0};
  for (const ReferenceObject& reference : run.references) {
    chart.add(cross(chart.to_px(view(reference.center)), kCrossSizes_px[static_cast<std::size_t>(reference.certainty)],
                    colors.at(reference.label)));
    if (wrong.references.count(reference.id) == 0) continue;
    chart.add(svg_circle(chart.to_px(view(reference.center)), kMissed_px,
                         "fill=\"none\" stroke-width=\"1.6\" stroke=\"" + std::string(kWrongColor) + '"'));
  }
  LabelPlacer placer(Vec2::Zero(), chart.inner());
  for (const auto& [shape, object] : confirmed) {
    chart.add(placer.place(object->label + " " + std::to_string(object->id), chart.to_px(shape.center),
                           chart.px_per_m() * shape.reach, "class=\"name\" fill=\"" + colors.at(object->label) + "\""));
  }
  std::vector<LegendEntry> entries = {{"#495057", "confirmed object", LegendEntry::kRing},
                                      {"#ced4da", "camera, optimised"}};
  if (run.object_evaluation) {
    entries.push_back({"#495057", "reference object", LegendEntry::kCross});
    entries.push_back({kWrongColor, "no reference object there", LegendEntry::kDash});
    entries.push_back({kWrongColor, "missed (certain) reference", LegendEntry::kRing});
  }
  return legend(entries) + chart.svg("confirmed objects from above");
}

}  // namespace semantic_topo_loop::core
