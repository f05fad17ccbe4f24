#include "ros/markers.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <set>
#include <string>
#include <tuple>
#include <utility>

#include "ros/conversions.h"

namespace semantic_topo_loop {
namespace {

using visualization_msgs::Marker;
using visualization_msgs::MarkerArray;
using visualization_msgs::MarkerArrayPtr;

std_msgs::ColorRGBA color(double r, double g, double b, double a) {
  std_msgs::ColorRGBA result;
  result.r = static_cast<float>(r);
  result.g = static_cast<float>(g);
  result.b = static_cast<float>(b);
  result.a = static_cast<float>(a);
  return result;
}

Marker make_marker(const std_msgs::Header& header, const std::string& layer, std::int64_t id, std::int32_t type) {
  Marker marker;
  marker.header = header;
  marker.ns = layer;
  marker.id = static_cast<std::int32_t>(id);
  marker.type = type;
  marker.action = Marker::ADD;
  marker.pose.orientation.w = 1.0;
  return marker;
}

MarkerArrayPtr make_array(const std_msgs::Header& header, const std::string& layer) {
  auto array = boost::make_shared<MarkerArray>();
  array->markers.push_back(make_marker(header, layer, 0, Marker::SPHERE));
  array->markers.back().action = Marker::DELETEALL;
  return array;
}

Marker make_lines(const std_msgs::Header& header, const std::string& layer, std::int64_t id, double width_m,
                  const std_msgs::ColorRGBA& line_color) {
  Marker lines = make_marker(header, layer, id, Marker::LINE_LIST);
  lines.scale.x = width_m;
  lines.color = line_color;
  return lines;
}

void add_line(const core::Vec3& from, const core::Vec3& to, Marker* lines) {
  lines->points.push_back(to_xyz<geometry_msgs::Point>(from));
  lines->points.push_back(to_xyz<geometry_msgs::Point>(to));
}

/// The pyramid from the camera's centre through the image's corners.
void add_frustum(const core::SE3& T_map_camera, const core::Vec3& corner, Marker* lines) {
  const std::array<core::Vec3, 4> corners = {T_map_camera * corner,
                                             T_map_camera * core::Vec3(-corner.x(), corner.y(), corner.z()),
                                             T_map_camera * core::Vec3(-corner.x(), -corner.y(), corner.z()),
                                             T_map_camera * core::Vec3(corner.x(), -corner.y(), corner.z())};
  for (std::size_t i = 0; i < corners.size(); ++i) {
    add_line(T_map_camera.t, corners[i], lines);
    add_line(corners[i], corners[(i + 1) % corners.size()], lines);
  }
}

/// Lines of loops, one for all that look the same.
struct LoopLines {
  explicit LoopLines(Marker lines) : marker(std::move(lines)) {}
  void add(const core::Vec3& query, const core::Vec3& match) {
    if (distinct.add(query, match)) add_line(query, match, &marker);
  }

  Marker marker;
  DistinctLoops distinct;
};

/// Each object with its nearest ones, each pair once.
std::set<std::pair<std::size_t, std::size_t>> neighbours(const std::vector<core::Vec3>& centers) {
  constexpr std::size_t kNeighbours = 3;  // enough to see the graph's shape, few enough to see the objects
  std::set<std::pair<std::size_t, std::size_t>> pairs;
  for (std::size_t i = 0; i < centers.size(); ++i) {
    std::vector<std::pair<double, std::size_t>> others;
    for (std::size_t j = 0; j < centers.size(); ++j) {
      if (j != i) others.emplace_back((centers[j] - centers[i]).norm(), j);
    }
    std::sort(others.begin(), others.end());
    for (std::size_t k = 0; k < std::min(kNeighbours, others.size()); ++k) {
      pairs.insert(std::minmax(i, others[k].second));
    }
  }
  return pairs;
}

}  // namespace

std_msgs::ColorRGBA class_color(int class_id, double alpha) {
  // The hue step that keeps COCO's indoor classes (24 to 79) farthest apart, with four tones, of all steps of 0.001.
  constexpr double kHueStep = 0.297;
  constexpr std::array<std::pair<double, double>, 4> kTones = {
      {{0.85, 1.0}, {0.50, 1.0}, {0.95, 0.75}, {0.60, 0.80}}};  // saturation, value
  const auto [saturation, value] = kTones[static_cast<std::size_t>(std::abs(class_id)) % kTones.size()];
  const double hue = 6.0 * std::fmod(std::abs(class_id) * kHueStep, 1.0);
  const auto channel = [hue, saturation = saturation, value = value](double offset) {
    const double k = std::fmod(offset + hue, 6.0);
    return value - value * saturation * std::clamp(std::min(k, 4.0 - k), 0.0, 1.0);
  };
  return color(channel(5.0), channel(3.0), channel(1.0), alpha);
}

MarkerArrayPtr make_quadric_markers(const MapView& view, const std_msgs::Header& header) {
  constexpr double kCandidateAlpha = 0.12, kAlphaMin = 0.45, kAlphaByQuality = 0.5;
  MarkerArrayPtr array = make_array(header, "quadrics");
  for (const auto& [id, landmark] : view.landmarks()) {
    if (!landmark.ellipsoid || landmark.state == core::LandmarkState::kRetired) continue;
    const bool confirmed = landmark.state == core::LandmarkState::kConfirmed;
    Marker marker = make_marker(header, confirmed ? "quadrics" : "candidates", id, Marker::SPHERE);
    marker.pose = to_msg(landmark.ellipsoid->T_world_quadric);
    marker.scale = to_xyz<geometry_msgs::Vector3>(2.0 * landmark.ellipsoid->semi_axes);
    const double alpha = kAlphaMin + kAlphaByQuality * std::clamp(landmark.quality, 0.0, 1.0);
    marker.color = class_color(landmark.class_id, confirmed ? alpha : kCandidateAlpha);
    array->markers.push_back(std::move(marker));
  }
  return array;
}

MarkerArrayPtr make_label_markers(const MapView& view, const std_msgs::Header& header, const core::ClassTable& classes,
                                  const MarkerSizes& sizes) {
  MarkerArrayPtr array = make_array(header, "labels");
  const core::Vec3 up = view.up();
  for (const auto& [id, landmark] : view.landmarks()) {
    if (!landmark.ellipsoid || landmark.state != core::LandmarkState::kConfirmed) continue;
    Marker marker = make_marker(header, "labels", id, Marker::TEXT_VIEW_FACING);
    const double half_height_m = std::sqrt(up.dot(landmark.ellipsoid->shape() * up));
    marker.pose.position =
        to_xyz<geometry_msgs::Point>(landmark.ellipsoid->center() + (half_height_m + sizes.label_m) * up);
    marker.scale.z = sizes.label_m;
    marker.color = color(1.0, 1.0, 1.0, 1.0);
    marker.text = classes.name(landmark.class_id);
    array->markers.push_back(std::move(marker));
  }
  return array;
}

MarkerArrayPtr make_topology_markers(const MapView& view, const std_msgs::Header& header, const MarkerSizes& sizes) {
  MarkerArrayPtr array = make_array(header, "topology");
  std::vector<core::Vec3> centers;
  for (const core::Landmark* object : view.objects_in_view()) centers.push_back(object->ellipsoid->center());
  Marker lines = make_lines(header, "topology", 0, sizes.line_m, color(0.25, 0.85, 1.0, 0.9));
  for (const auto& [i, j] : neighbours(centers)) add_line(centers[i], centers[j], &lines);
  if (!lines.points.empty()) array->markers.push_back(std::move(lines));
  return array;
}

MarkerArrayPtr make_loop_markers(const MapView& view, const std_msgs::Header& header, const MarkerSizes& sizes) {
  MarkerArrayPtr array = make_array(header, "loops");
  LoopLines kept(make_lines(header, "loops", 0, sizes.line_m, color(0.2, 0.9, 0.3, 0.45)));
  LoopLines rejected(make_lines(header, "loops", 1, 2.0 * sizes.line_m, color(1.0, 0.2, 0.2, 0.9)));
  for (const auto* loops : {&view.loops(), &view.extra_loops()}) {
    for (const auto& [loop, accepted] : *loops) {
      const auto query = view.keyframes().find(loop.first);
      const auto match = view.keyframes().find(loop.second);
      if (query == view.keyframes().end() || match == view.keyframes().end()) continue;
      (accepted.kept ? kept : rejected).add(query->second.T_map_camera.t, match->second.T_map_camera.t);
    }
  }
  for (Marker* lines : {&kept.marker, &rejected.marker}) {
    if (!lines->points.empty()) array->markers.push_back(std::move(*lines));
  }
  return array;
}

LoopMapPtr make_loop_map(const MapView& view, const std_msgs::Header& header, std::uint32_t session_id) {
  auto map = boost::make_shared<LoopMap>();
  map->header = header;
  map->session_id = session_id;
  const auto add = [&view, &map](const MapView::Loop& loop, core::LoopReason reason, bool kept) {
    const auto query = view.keyframes().find(loop.first);
    const auto match = view.keyframes().find(loop.second);
    if (query == view.keyframes().end() || match == view.keyframes().end()) return false;
    LoopPlace& place = map->loops.emplace_back();
    std::tie(place.query_keyframe_id, place.match_keyframe_id) = loop;
    place.reason = static_cast<std::uint8_t>(reason);
    place.kept = kept;
    place.query = to_xyz<geometry_msgs::Point>(query->second.T_map_camera.t);
    place.match = to_xyz<geometry_msgs::Point>(match->second.T_map_camera.t);
    return true;
  };
  for (const auto& [loop, accepted] : view.loops()) {
    if (!add(loop, core::LoopReason::kAccepted, accepted.kept)) continue;
    for (const core::Landmark* object : view.matched_objects(accepted.matches)) {
      map->loops.back().landmark_ids.push_back(object->id);
      map->loops.back().objects.push_back(to_xyz<geometry_msgs::Point>(object->ellipsoid->center()));
    }
  }
  for (const auto& [loop, accepted] : view.extra_loops()) add(loop, core::LoopReason::kAccepted, accepted.kept);
  for (const auto& [loop, reason] : view.refused_loops()) add(loop, reason, false);
  return map;
}

MarkerArrayPtr make_keyframe_markers(const MapView& view, const std_msgs::Header& header, const MarkerSizes& sizes) {
  MarkerArrayPtr array = make_array(header, "keyframes");
  if (!view.frame()) return array;
  const core::Camera& camera = view.frame()->camera;
  const core::Vec3 corner =
      sizes.camera_m * core::Vec3(0.5 * camera.width / camera.fx, 0.5 * camera.height / camera.fy, 1.0);
  Marker lines = make_lines(header, "keyframes", 0, 0.25 * sizes.line_m, color(0.45, 0.55, 0.75, 0.6));
  constexpr std::size_t kMost = 500;  // with more the image is one colour, and the messages are large
  const std::size_t step = thinning(view.keyframes().size(), kMost);
  std::size_t i = 0;
  for (const auto& [id, keyframe] : view.keyframes()) {
    if (i++ % step == 0) add_frustum(keyframe.T_map_camera, corner, &lines);
  }
  Marker current = make_lines(header, "keyframes", 1, sizes.line_m, color(1.0, 0.85, 0.2, 1.0));
  add_frustum(view.T_map_odom() * view.frame()->T_odom_camera, 2.0 * corner, &current);
  if (!lines.points.empty()) array->markers.push_back(std::move(lines));
  array->markers.push_back(std::move(current));
  return array;
}

}  // namespace semantic_topo_loop
