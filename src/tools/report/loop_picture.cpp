#include "tools/report/loop_picture.h"

#include <algorithm>
#include <array>
#include <limits>
#include <vector>

#include "semantic_topo_loop/types/text.h"
#include "tools/report/chart.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kWidth_px = 1120.0, kHeight_px = 350.0, kTitle_px = 22.0, kGap_px = 26.0, kFont_px = 10.5;
constexpr const char* kMatchCamera = "#343a40";
constexpr const char* kQueryCamera = "#868e96";

/// An object of a submap from above, with the match's camera in the origin.
struct SeenObject {
  const LoopObjectRecord* record = nullptr;
  Vec2 center = Vec2::Zero();
  double radius_m = 0.0;
};

/// A submap from above.
struct SeenSubmap {
  std::vector<SeenObject> objects;
  Vec2 camera = Vec2::Zero(), optical_axis = Vec2::Zero();

  void extend(Extent* extent) const {
    for (const SeenObject& object : objects) extent->add(object.center, Vec2::Constant(object.radius_m));
  }
};

/// @param t of the camera, in the view   @param scale of the view's unit of length over the submap's
SeenSubmap from_above(const std::vector<LoopObjectRecord>& records, const Mat3& R_view_camera, const Vec3& t,
                      double scale) {
  SeenSubmap submap;
  for (const LoopObjectRecord& record : records) {
    const Vec3 at = scale * (R_view_camera * record.object.position) + t;
    submap.objects.push_back({&record, at.head<2>(), scale * record.object.radius_m});
  }
  submap.camera = t.head<2>();
  submap.optical_axis = R_view_camera.col(2).head<2>();
  return submap;
}

/// One of the three parts of the picture.
struct Panel {
  Vec2 origin_px, size_px;
  Vec2 middle_m;  ///< what is in its middle
  double px_per_m = 1.0;

  Vec2 to_px(const Vec2& p) const {
    return origin_px + 0.5 * size_px + px_per_m * Vec2(p.x() - middle_m.x(), middle_m.y() - p.y());
  }
};

/// The panels, which have one scale: that in which each shows its extent.
std::array<Panel, 3> lay_out(const std::array<Extent, 3>& extents) {
  constexpr double kUsed = 0.82, kMinSize_m = 0.2;  // of a panel; around it there is space for names
  const Vec2 size((kWidth_px - 2.0 * kGap_px) / 3.0, kHeight_px);
  std::array<Panel, 3> panels;
  double px_per_m = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < panels.size(); ++i) {
    const Vec2 needed = (extents[i].max - extents[i].min).cwiseMax(kMinSize_m);
    px_per_m = std::min(px_per_m, kUsed * size.cwiseQuotient(needed).minCoeff());
    panels[i].origin_px = Vec2(static_cast<double>(i) * (size.x() + kGap_px), kTitle_px);
    panels[i].size_px = size;
    panels[i].middle_m = 0.5 * (extents[i].min + extents[i].max);
  }
  for (Panel& panel : panels) panel.px_per_m = px_per_m;
  return panels;
}

std::string draw_frame(const Panel& panel, const std::string& title) {
  return "<rect class=\"panel\" x=\"" + px(panel.origin_px.x()) + "\" y=\"" + px(panel.origin_px.y()) + "\" width=\"" +
         px(panel.size_px.x()) + "\" height=\"" + px(panel.size_px.y()) +
         "\" rx=\"6\"/>\n<text class=\"panel-title\" x=\"" + px(panel.origin_px.x() + 2.0) + "\" y=\"" +
         px(panel.origin_px.y() - 8.0) + "\">" + escaped(title) + "</text>\n";
}

std::string draw_scale(const Panel& panel) {
  constexpr double kPart = 0.3, kInset_px = 14.0;
  double length_m = 1.0;
  while (length_m * panel.px_per_m > kPart * panel.size_px.x()) length_m *= 0.5;
  const Vec2 from = panel.origin_px + Vec2(kInset_px, panel.size_px.y() - kInset_px);
  return svg_line(from, from + Vec2(length_m * panel.px_per_m, 0.0), "stroke=\"#52606d\" stroke-width=\"2\"") +
         "<text class=\"note\" x=\"" + px(from.x()) + "\" y=\"" + px(from.y() - 5.0) + "\">" +
         format_general(length_m, 3) + " m</text>\n";
}

std::string draw_camera(const Panel& panel, const SeenSubmap& submap, const std::string& color) {
  constexpr double kLength_px = 13.0, kHalfWidth_px = 5.0;
  const Vec2 inset = Vec2::Constant(kLength_px);
  const Vec2 ahead = Vec2(submap.optical_axis.x(), -submap.optical_axis.y()).normalized();
  const Vec2 side = kHalfWidth_px * Vec2(-ahead.y(), ahead.x());
  const Vec2 foot =
      panel.to_px(submap.camera).cwiseMax(panel.origin_px + inset).cwiseMin(panel.origin_px + panel.size_px - inset);
  std::string path = "M";
  for (const Vec2& corner : {Vec2(foot + kLength_px * ahead), Vec2(foot + side), Vec2(foot - side)}) {
    path += (path.size() > 1 ? "L" : "") + px(corner.x()) + ' ' + px(corner.y());
  }
  return "<path d=\"" + path + "Z\" fill=\"" + color + "\"/>\n";
}

std::string draw_objects(const Panel& panel, const SeenSubmap& submap, const ClassColors& colors) {
  constexpr double kMinRadius_px = 2.5;
  std::string svg;
  for (const SeenObject& object : submap.objects) {
    const std::string& color = colors.at(object.record->label);
    const double radius = std::max(panel.px_per_m * object.radius_m, kMinRadius_px);
    svg += svg_circle(panel.to_px(object.center), radius,
                      object.record->pair < 0 ? "class=\"alone\""
                                              : "class=\"matched\" fill=\"" + color + "\" stroke=\"" + color + '"');
  }
  return svg;
}

std::string draw_names(const Panel& panel, const SeenSubmap& submap, const ClassColors& colors) {
  std::string svg;
  LabelPlacer placer(panel.origin_px, panel.origin_px + panel.size_px);
  for (const SeenObject& object : submap.objects) {
    const std::string& label = object.record->label;
    svg += placer.place(
        label, panel.to_px(object.center), Vec2::Constant(panel.px_per_m * object.radius_m),
        object.record->pair < 0 ? "class=\"alone name\"" : "class=\"name\" fill=\"" + colors.at(label) + '"', kFont_px);
  }
  return svg;
}

/// Lines between the objects of each pair.   @param colors null: without
std::string draw_pairs(const Panel& panel_a, const SeenSubmap& a, const Panel& panel_b, const SeenSubmap& b,
                       const ClassColors* colors) {
  std::string svg;
  for (const SeenObject& p : a.objects) {
    for (const SeenObject& q : b.objects) {
      if (p.record->pair < 0 || p.record->pair != q.record->pair) continue;
      svg += svg_line(panel_a.to_px(p.center), panel_b.to_px(q.center),
                      colors == nullptr ? "" : "stroke=\"" + colors->at(p.record->label) + '"');
    }
  }
  return svg;
}

std::string group(const std::string& attributes, const std::string& content) {
  return "<g " + attributes + ">" + content + "</g>\n";
}

}  // namespace

std::string draw_loop(const RunData& run, const ShownLoop& loop, const TopView& view, const ClassColors& colors) {
  const LoopRecord& record = loop.record;
  Mat3 R_view_query = Mat3::Identity();
  if (const StampedPose* pose = run.pose_of(record.query_frame)) {
    R_view_query = view.R_view_world * (run.optimised().S_world_map.T.q * pose->T_world_camera.q).toRotationMatrix();
  }
  const Mat3 R_view_match = R_view_query * record.T_match_query.rotation().transpose();
  const SeenSubmap match = from_above(loop.match, R_view_match, Vec3::Zero(), 1.0);
  const SeenSubmap query = from_above(loop.query, R_view_query, Vec3::Zero(), record.scale);
  const SeenSubmap laid_over =
      from_above(loop.query, R_view_query, R_view_match * record.T_match_query.t, record.scale);

  std::array<Extent, 3> extents;
  match.extend(&extents[0]);
  query.extend(&extents[1]);
  match.extend(&extents[2]);
  laid_over.extend(&extents[2]);
  const std::array<Panel, 3> panels = lay_out(extents);
  const std::string names = "font-size=\"" + px(kFont_px) + '"';

  std::string svg = draw_frame(panels[0], "match: " + run.match_time(record)) +
                    draw_frame(panels[1], "query: " + format_fixed(run.seconds(record.query_stamp_ns), 1) + " s") +
                    draw_frame(panels[2], "laid over each other");
  svg += group("class=\"pairs\"", draw_pairs(panels[0], match, panels[1], query, &colors));
  svg += draw_objects(panels[0], match, colors) + draw_objects(panels[2], match, colors);
  svg += group("class=\"query\"", draw_objects(panels[1], query, colors) + draw_objects(panels[2], laid_over, colors));
  svg += group("class=\"off\"", draw_pairs(panels[2], match, panels[2], laid_over, nullptr));
  svg += draw_camera(panels[0], match, kMatchCamera) + draw_camera(panels[1], query, kQueryCamera) +
         draw_camera(panels[2], match, kMatchCamera) + draw_camera(panels[2], laid_over, kQueryCamera);
  svg += group(names, draw_names(panels[0], match, colors) + draw_names(panels[1], query, colors));
  for (const Panel& panel : panels) svg += draw_scale(panel);
  return "<svg class=\"chart\" role=\"img\" viewBox=\"0 0 " + px(kWidth_px) + ' ' + px(kTitle_px + kHeight_px + 2.0) +
         "\" aria-label=\"the two submaps of loop " + std::to_string(loop.number) + "\">\n" + svg + "</svg>\n";
}

}  // namespace semantic_topo_loop::core
