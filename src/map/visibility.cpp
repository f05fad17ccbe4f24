#include "visibility.h"

#include <algorithm>

namespace semantic_topo_loop::core {
namespace {

constexpr double kMinWidthPx = 12.0, kMinHeightPx = 8.0;
constexpr double kFullyVisibleShare = 0.8;
constexpr double kHiddenShare = 0.5;  // of the box, from which on it counts as hidden
constexpr double kPointMargin_m = 0.1;
constexpr std::size_t kMinPoints = 5;

struct Candidate {
  std::int64_t id = -1;
  Box box;
  double near_m = 0.0, center_m = 0.0;  ///< depths of the near side and the centre
};

bool is_hidden_by_landmark(const Candidate& candidate, const std::vector<Candidate>& all) {
  return std::any_of(all.begin(), all.end(), [&](const Candidate& other) {
    return other.id != candidate.id && other.center_m < candidate.near_m &&
           intersection_area(other.box, candidate.box) > kHiddenShare * candidate.box.area();
  });
}

/// Boxes of classes that are never mapped may be people who stand in front.
bool is_hidden_by_other(const Candidate& candidate, const AssociationFrame& associations) {
  return std::any_of(associations.associations.begin(), associations.associations.end(), [&](const Association& a) {
    return a.level == AssociationLevel::kIgnored &&
           intersection_area(a.box, candidate.box) > kHiddenShare * candidate.box.area();
  });
}

bool is_hidden_by_points(const Candidate& candidate, const Frame& frame) {
  if (!frame.points_camera) return false;
  std::size_t inside = 0, in_front = 0;
  for (const Vec3& point : *frame.points_camera) {
    if (!(point.z() > 0.0)) continue;
    const double u = frame.camera.fx * point.x() / point.z() + frame.camera.cx;
    const double v = frame.camera.fy * point.y() / point.z() + frame.camera.cy;
    if (u < candidate.box.x1 || u > candidate.box.x2 || v < candidate.box.y1 || v > candidate.box.y2) continue;
    ++inside;
    if (point.z() < candidate.near_m - kPointMargin_m) ++in_front;
  }
  return inside >= kMinPoints && static_cast<double>(in_front) > kHiddenShare * static_cast<double>(inside);
}

}  // namespace

std::vector<ExpectedLandmark> expected_landmarks(const std::map<std::int64_t, MappedLandmark>& landmarks,
                                                 const Frame& frame, const SE3& T_map_camera,
                                                 const AssociationFrame& associations) {
  const Mat34 P = projection_matrix(frame.camera, T_map_camera);
  std::vector<Candidate> in_view;
  for (const auto& [id, landmark] : landmarks) {
    if (!landmark.state.ellipsoid || landmark.state.state == LandmarkState::kRetired) continue;
    const Mat3 shape = landmark.state.ellipsoid->shape();
    const Vec3& center = landmark.state.ellipsoid->center();
    const std::optional<Box> box = project_box(center, shape, P);
    if (!box) continue;
    const Box visible = clip(*box, frame.camera.width, frame.camera.height);
    if (visible.area() <= kFullyVisibleShare * box->area() || visible.width() <= kMinWidthPx ||
        visible.height() <= kMinHeightPx) {
      continue;
    }
    const Vec3 axis = P.row(2).head<3>().transpose();
    const double depth = axis.dot(center) + P(2, 3);
    in_view.push_back({id, visible, depth - std::sqrt(std::max(0.0, axis.dot(shape * axis))), depth});
  }
  std::vector<ExpectedLandmark> expected;
  for (const Candidate& candidate : in_view) {
    if (is_hidden_by_landmark(candidate, in_view) || is_hidden_by_other(candidate, associations) ||
        is_hidden_by_points(candidate, frame)) {
      continue;
    }
    expected.push_back({candidate.id, candidate.box.size()});
  }
  return expected;
}

}  // namespace semantic_topo_loop::core
