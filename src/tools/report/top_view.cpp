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

constexpr double kPageWidth_px = 1120.0, kHalfWidth_px = 550.0;
constexpr const char* kTruthColor = "#1f2933";
constexpr const char* kGrey = "#9aa5b1";

/// Corners of what is to be seen.
struct Extent {
  Vec2 min = Vec2::Constant(std::numeric_limits<double>::infinity());
  Vec2 max = -min;

  void add(const Vec2& point, const Vec2& reach = Vec2::Zero()) {
    min = min.cwiseMin(point - reach);
    max = max.cwiseMax(point + reach);
  }
  bool is_empty() const { return min.x() > max.x(); }
};

Chart plan(double width_px, double height_max, const Extent& extent) {
  if (extent.is_empty()) return Chart::plan(width_px, height_max, Vec2::Zero(), Vec2::Zero());
  return Chart::plan(width_px, height_max, extent.min, extent.max);
}

std::vector<Vec2> from_above(const StampedPoses& poses, const Sim3& S_world_map, const TopView& view) {
  std::vector<Vec2> points;
  points.reserve(poses.size());
  for (const StampedPose& pose : poses) points.push_back(view(S_world_map * pose.T_world_camera.t));
  return points;
}

std::string circle(const Vec2& at, double radius, const std::string& attributes) {
  return "<circle cx=\"" + px(at.x()) + "\" cy=\"" + px(at.y()) + "\" r=\"" + px(radius) + "\" " + attributes + "/>\n";
}

std::string segment(const Vec2& from, const Vec2& to, const std::string& attributes) {
  return "<line x1=\"" + px(from.x()) + "\" y1=\"" + px(from.y()) + "\" x2=\"" + px(to.x()) + "\" y2=\"" + px(to.y()) +
         "\" " + attributes + "/>\n";
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
  return segment(at - Vec2(size, size), at + Vec2(size, size), stroke) +
         segment(at - Vec2(size, -size), at + Vec2(size, -size), stroke);
}

// --- loops --------------------------------------------------------------------------------------------------------

/// An object of a submap, seen from above, the match's camera in the origin.
struct SeenObject {
  const LoopObjectRecord* record = nullptr;
  Vec2 center = Vec2::Zero();
  double radius_m = 0.0;
};

/// A part of the picture of a loop.
struct Panel {
  Vec2 origin_px, size_px;  ///< of the part
  Vec2 middle_m;            ///< what is in its middle
  double px_per_m = 1.0;

  Vec2 to_px(const Vec2& p) const {
    return origin_px + 0.5 * size_px + px_per_m * Vec2(p.x() - middle_m.x(), middle_m.y() - p.y());
  }
};

std::vector<SeenObject> seen(const std::vector<LoopObjectRecord>& records, const Mat3& R_view_camera, const Vec3& t,
                             double scale) {
  std::vector<SeenObject> objects;
  for (const LoopObjectRecord& record : records) {
    const Vec3 at = scale * (R_view_camera * record.object.position) + t;
    objects.push_back({&record, at.head<2>(), scale * record.object.radius_m});
  }
  return objects;
}

Extent extent_of(const std::vector<SeenObject>& objects, const Vec2& camera) {
  Extent extent;
  extent.add(camera);
  for (const SeenObject& object : objects) extent.add(object.center, Vec2::Constant(object.radius_m));
  return extent;
}

/// An arrow head at the camera, along its optical axis.
std::string camera_mark(const Panel& panel, const Vec2& at, const Vec2& axis, const std::string& color) {
  constexpr double kLength = 13.0, kHalfWidth = 5.0;
  const Vec2 ahead = Vec2(axis.x(), -axis.y()).normalized(), side(-ahead.y(), ahead.x());
  const Vec2 foot = panel.to_px(at), tip = foot + kLength * ahead;
  const Vec2 left = foot + kHalfWidth * side, right = foot - kHalfWidth * side;
  return "<path d=\"M" + px(tip.x()) + ' ' + px(tip.y()) + 'L' + px(left.x()) + ' ' + px(left.y()) + 'L' +
         px(right.x()) + ' ' + px(right.y()) + "Z\" fill=\"" + color + "\"/>\n";
}

std::string draw_submap(const Panel& panel, const std::vector<SeenObject>& objects, const ClassColors& colors,
                        const std::string& attributes, bool with_labels) {
  std::string svg;
  LabelPlacer placer(panel.origin_px + panel.size_px);
  for (const SeenObject& object : objects) {
    const bool is_matched = object.record->pair >= 0;
    const std::string color = is_matched ? colors.at(object.record->label) : kGrey;
    const Vec2 at = panel.to_px(object.center);
    const double radius = std::max(panel.px_per_m * object.radius_m, 2.5);
    svg += circle(at, radius,
                  "fill=\"" + color + "\" fill-opacity=\"" + (is_matched ? "0.16" : "0.06") + "\" stroke=\"" + color +
                      "\" stroke-width=\"" + (is_matched ? "1.6" : "1") + "\" " + attributes);
    if (with_labels) {
      svg += placer.place(object.record->label, at, Vec2::Constant(radius),
                          "class=\"name\" fill=\"" + std::string(is_matched ? color : kGrey) + "\"", 10.5);
    }
  }
  return svg;
}

/// What a bar in the corner of a panel says of its scale.
std::string scale_bar(const Panel& panel) {
  constexpr double kPart = 0.3, kInset = 14.0;
  double length_m = 1.0;
  while (length_m * panel.px_per_m > kPart * panel.size_px.x()) length_m *= 0.5;
  const Vec2 from = panel.origin_px + Vec2(kInset, panel.size_px.y() - kInset);
  const Vec2 to = from + Vec2(length_m * panel.px_per_m, 0.0);
  return segment(from, to, "stroke=\"#52606d\" stroke-width=\"2\"") + "<text class=\"note\" x=\"" + px(from.x()) +
         "\" y=\"" + px(from.y() - 5.0) + "\">" + format_general(length_m, 3) + " m</text>\n";
}

std::string frame_of(const Panel& panel, const std::string& title) {
  return "<rect class=\"panel\" x=\"" + px(panel.origin_px.x()) + "\" y=\"" + px(panel.origin_px.y()) + "\" width=\"" +
         px(panel.size_px.x()) + "\" height=\"" + px(panel.size_px.y()) +
         "\" rx=\"6\"/>\n<text class=\"panel-title\" x=\"" + px(panel.origin_px.x() + 2.0) + "\" y=\"" +
         px(panel.origin_px.y() - 8.0) + "\">" + escaped(title) + "</text>\n";
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
  constexpr std::array<const char*, 12> kColors = {"#1c7ed6", "#e8590c", "#2b8a3e", "#9c36b5", "#0c8599", "#a61e4d",
                                                   "#5c940d", "#6741d9", "#b08900", "#8a5a44", "#364fc7", "#c2255c"};
  std::set<std::string> labels;
  for (const MappedObject& object : run.objects) labels.insert(object.label);
  for (const ReferenceObject& reference : run.references) labels.insert(reference.label);
  for (const ShownLoop& loop : run.loops) {
    for (const auto* side : {&loop.query, &loop.match}) {
      for (const LoopObjectRecord& object : *side) labels.insert(object.label);
    }
  }
  ClassColors colors;
  for (const std::string& label : labels) {
    const std::size_t next = colors.size() % kColors.size();
    colors.emplace(label, kColors[next]);
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
    for (const Vec2& p : points) extent.add(p);
  }
  Chart chart = plan(kHalfWidth_px, 0.85, extent);
  for (const auto& [points, color] : lines) {
    const bool is_truth = color == kTruthColor;
    chart.line(
        points, color,
        is_truth ? "stroke-width=\"1\" stroke-dasharray=\"4 3\"" : "stroke-width=\"1.6\" stroke-opacity=\"0.9\"");
  }
  return legend(entries) + chart.svg("trajectories from above");
}

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
  if (extent.is_empty()) {
    for (const Vec2& p : path) extent.add(p);
  }
  std::stable_sort(confirmed.begin(), confirmed.end(),
                   [](const auto& a, const auto& b) { return a.first.semi_axes.prod() > b.first.semi_axes.prod(); });
  Chart chart = plan(kPageWidth_px, 0.62, extent);
  chart.line(path, "#ced4da", "stroke-width=\"1\"");
  for (const auto& [shape, object] : confirmed) {
    const std::string& color = colors.at(object->label);
    chart.add(ellipse(chart, shape,
                      "fill=\"" + color + "\" fill-opacity=\"0.18\" stroke=\"" + color + "\" stroke-width=\"1.6\"",
                      object->label + " " + std::to_string(object->id)));
  }
  constexpr std::array<double, 3> kCrossSizes_px = {5.0, 4.0, 3.0};
  for (const ReferenceObject& reference : run.references) {
    chart.add(cross(chart.to_px(view(reference.center)), kCrossSizes_px[static_cast<std::size_t>(reference.certainty)],
                    colors.at(reference.label)));
  }
  LabelPlacer placer(chart.inner());
  for (const auto& [shape, object] : confirmed) {
    chart.add(placer.place(object->label + " " + std::to_string(object->id), chart.to_px(shape.center),
                           chart.px_per_m() * shape.reach, "class=\"name\" fill=\"" + colors.at(object->label) + "\""));
  }
  std::vector<LegendEntry> entries = {{"#495057", "confirmed object", LegendEntry::kRing},
                                      {"#ced4da", "camera, optimised"}};
  if (!run.references.empty()) entries.push_back({"#495057", "reference object", LegendEntry::kCross});
  return legend(entries) + chart.svg("confirmed objects from above");
}

std::string draw_loop(const RunData& run, const ShownLoop& loop, const TopView& view, const ClassColors& colors) {
  constexpr double kHeight_px = 360.0, kTitle_px = 22.0, kGap_px = 26.0;
  constexpr double kPanel_px = (kPageWidth_px - 2.0 * kGap_px) / 3.0;
  const LoopRecord& record = loop.record;
  const StampedPose* query_pose = run.pose_of(record.query_frame);
  Mat3 R_view_query = Mat3::Identity();
  if (query_pose != nullptr) {
    R_view_query =
        view.R_view_world * (run.optimised().S_world_map.T.q * query_pose->T_world_camera.q).toRotationMatrix();
  }
  const Mat3 R_view_match = R_view_query * record.T_match_query.rotation().transpose();
  const Vec3 query_camera = R_view_match * record.T_match_query.t;
  const auto match = seen(loop.match, R_view_match, Vec3::Zero(), 1.0);
  const auto query = seen(loop.query, R_view_query, Vec3::Zero(), record.scale);
  const auto laid_over = seen(loop.query, R_view_query, query_camera, record.scale);

  const Vec2 second_camera = query_camera.head<2>();
  Extent both = extent_of(match, Vec2::Zero());
  for (const SeenObject& object : laid_over) both.add(object.center, Vec2::Constant(object.radius_m));
  both.add(second_camera);
  std::array<Extent, 3> extents = {extent_of(match, Vec2::Zero()), extent_of(query, Vec2::Zero()), both};
  std::array<Panel, 3> panels;
  const Vec2 size(kPanel_px, kHeight_px);
  double px_per_m = 1e9;
  for (std::size_t i = 0; i < panels.size(); ++i) {
    constexpr double kMargin = 0.8;  // of a panel is used, the rest is for names
    const Vec2 needed = (extents[i].max - extents[i].min).cwiseMax(0.2);
    px_per_m = std::min(px_per_m, kMargin * size.cwiseQuotient(needed).minCoeff());
    panels[i] = {{static_cast<double>(i) * (kPanel_px + kGap_px), kTitle_px},
                 size,
                 0.5 * (extents[i].min + extents[i].max),
                 1.0};
  }
  for (Panel& panel : panels) panel.px_per_m = px_per_m;

  const auto at = [&](std::int64_t stamp_ns) { return format_fixed(run.seconds(stamp_ns), 1) + " s"; };
  std::string svg = frame_of(panels[0], "match, at " + at(record.match_stamp_ns)) +
                    frame_of(panels[1], "query, at " + at(record.query_stamp_ns)) +
                    frame_of(panels[2], "laid over each other");
  for (const SeenObject& a : match) {
    for (const SeenObject& b : query) {
      if (a.record->pair < 0 || a.record->pair != b.record->pair) continue;
      svg += segment(panels[0].to_px(a.center), panels[1].to_px(b.center),
                     "stroke=\"" + colors.at(a.record->label) + "\" stroke-width=\"1.2\" stroke-opacity=\"0.45\"");
    }
  }
  const Vec2 match_axis = R_view_match.col(2).head<2>(), query_axis = R_view_query.col(2).head<2>();
  svg += draw_submap(panels[0], match, colors, "", true) + camera_mark(panels[0], Vec2::Zero(), match_axis, "#343a40");
  svg += draw_submap(panels[1], query, colors, "stroke-dasharray=\"4 2\"", true) +
         camera_mark(panels[1], Vec2::Zero(), query_axis, "#868e96");
  svg += draw_submap(panels[2], match, colors, "", false) +
         draw_submap(panels[2], laid_over, colors, "stroke-dasharray=\"4 2\"", false) +
         camera_mark(panels[2], Vec2::Zero(), match_axis, "#343a40") +
         camera_mark(panels[2], second_camera, query_axis, "#868e96");
  for (const SeenObject& a : match) {
    for (const SeenObject& b : laid_over) {
      if (a.record->pair < 0 || a.record->pair != b.record->pair) continue;
      svg += segment(panels[2].to_px(a.center), panels[2].to_px(b.center), "stroke=\"#c92a2a\" stroke-width=\"2\"");
    }
  }
  for (const Panel& panel : panels) svg += scale_bar(panel);
  return "<svg class=\"chart\" role=\"img\" viewBox=\"0 0 " + px(kPageWidth_px) + ' ' +
         px(kHeight_px + kTitle_px + 2.0) + "\" aria-label=\"the two submaps of loop " + std::to_string(loop.number) +
         "\">\n" + svg + "</svg>\n";
}

}  // namespace semantic_topo_loop::core
