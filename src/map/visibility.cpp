#include "map/visibility.h"

#include <algorithm>

#include "geometry/depth_noise.h"
#include "map/surface_cost.h"
#include "semantic_topo_loop/geometry/quadric.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kMinWidthPx = 12.0, kMinHeightPx = 8.0;
constexpr double kFullyVisibleShare = 0.8;
constexpr double kHiddenShare = 0.5;  // of the box, from which on it counts as hidden
constexpr double kSigmas = 2.5;
constexpr double kMiddle = 0.6;            // of the sides of the projection
constexpr double kSeenThroughShare = 0.5;  // of its middle, from which on nothing seems to be there
constexpr std::size_t kMinPoints = 5, kPointsMax = 80;

struct Candidate {
  std::int64_t id = -1;
  const Ellipsoid* ellipsoid = nullptr;
  Box box, whole;                       ///< inside the image, and not clipped
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

/// What depth says about the place of a landmark.
enum class DepthThere { kUnknown, kInFront, kAtIt, kBehind };

/// By the points in the middle of its projection, where its near side should be; the border shows what is around it.
DepthThere depth_there(const Candidate& candidate, const FramePoints& points, const SE3& T_map_camera) {
  const Vec2 middle = candidate.whole.center();
  const double half_width = 0.5 * kMiddle * candidate.whole.width();
  const double half_height = 0.5 * kMiddle * candidate.whole.height();
  const Box box{middle.x() - half_width, middle.y() - half_height, middle.x() + half_width, middle.y() + half_height};
  const QuadricFitOptions shape;
  const double uneven = shape.surface_sigma_m + shape.surface_share * candidate.ellipsoid->radius();
  std::size_t known = 0, in_front = 0, behind = 0;
  for (const SeenPoint& p : points.in(box, kPointsMax)) {
    const double z = p.point_camera.z();
    const std::optional<RayDepth> there =
        surface_depth(*candidate.ellipsoid, T_map_camera.t, T_map_camera.q * Vec3(p.point_camera / z));
    if (!there) continue;
    const double margin = kSigmas * (uneven + depth_sigma_m(z));
    ++known;
    if (z < there->depth - margin) ++in_front;
    if (z > there->depth + margin) ++behind;
  }
  if (known < kMinPoints) return DepthThere::kUnknown;
  const auto share = [known](std::size_t count) { return static_cast<double>(count) / static_cast<double>(known); };
  if (share(in_front) > kHiddenShare) return DepthThere::kInFront;
  return share(behind) > kSeenThroughShare ? DepthThere::kBehind : DepthThere::kAtIt;
}

}  // namespace

std::vector<ExpectedLandmark> expected_landmarks(const std::map<std::int64_t, MappedLandmark>& landmarks,
                                                 const Frame& frame, const FramePoints* points, const SE3& T_map_camera,
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
    in_view.push_back({id, &*landmark.state.ellipsoid, visible, *box,
                       depth - std::sqrt(std::max(0.0, axis.dot(shape * axis))), depth});
  }
  std::vector<ExpectedLandmark> expected;
  for (const Candidate& candidate : in_view) {
    if (is_hidden_by_landmark(candidate, in_view) || is_hidden_by_other(candidate, associations)) continue;
    const DepthThere there = points != nullptr ? depth_there(candidate, *points, T_map_camera) : DepthThere::kUnknown;
    if (there == DepthThere::kInFront) continue;
    expected.push_back({candidate.id, candidate.box.size(), there == DepthThere::kBehind});
  }
  return expected;
}

}  // namespace semantic_topo_loop::core
