#include <algorithm>
#include <cmath>

#include "geometry/wide_image.h"
#include "map/mapped_landmark.h"
#include "semantic_topo_loop/geometry/quadric.h"

namespace semantic_topo_loop::core {
namespace {

// Of the time to be seen for: what no image shows the end of is no object. The second, of boxes alone, on simulated
// desks, and on fr3_office, where 0.2 makes one more chair.
constexpr double kBoundedShare = 0.2, kBoundedShareOfBoxes = 0.5;
// Of familiar views: what depth places and a detector finds again no more often is a mistake of it. Chosen on fr1_xyz,
// its images thinned and boxes dropped: objects from 0.30 on (60 % dropped), mistakes 0.12 to 0.31.
constexpr double kFoundAgainShare = 0.25;
// Of familiar views, below which that share says little. Those mistakes had 2 s and more.
constexpr double kFamiliar_s = 1.0;
// Seen for longer is there, from however few of the keyframes that expect it: walls of houses hide things, and nothing
// tells of them. The mistakes on fr2_desk's drifted files were seen for 2 to 9 s.
constexpr double kSurelyThere_s = 10.0;
constexpr double kTransparentShare = 0.1;  // of the time seen: what shows more of its background has holes
constexpr double kMinWidth_px = 12.0, kMinHeight_px = 8.0;  // of a projection at VGA that a detector is expected to box
constexpr double kRange_m = 10.0;                           // association looks no farther (association.range_m)
constexpr double kPartlyVisibleShare = 0.4;                 // of its area, for depth to show what lies behind it
constexpr double kHiddenShare = 0.5;                        // of the box, from which on it counts as hidden
constexpr double kSigmas = 2.5;            // of a depth, beyond which it is in front or behind: 1 in 80 by chance
constexpr double kUneven_m = 0.01;         // of a surface against its ellipsoid
constexpr double kUnevenShare = 0.15;      // the same, as a share of its radius
constexpr double kMiddle = 0.6;            // of the sides of the projection
constexpr double kSeenThroughShare = 0.5;  // of its middle, from which on nothing seems to be there
constexpr std::size_t kMinPoints = 5;      // fewer could all be wrong
constexpr std::size_t kPointsMax = 80;     // a share of them is known to 6 %

struct Candidate {
  std::int64_t id = -1;
  const Ellipsoid* ellipsoid = nullptr;
  Box box, whole;                       ///< inside the image, and not clipped
  double near_m = 0.0, center_m = 0.0;  ///< depths of the near side and the centre
  bool is_hollow = false;
  bool is_looked_for = false;  ///< enough of it is in view; less hides others all the same

  double share() const { return box.area() / whole.area(); }
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
enum class DepthThere { kUnknown, kInFront, kAtIt, kInIt, kBehind };

/// By the points in the middle of its projection, where its near side should be; the border shows what is around it.
DepthThere depth_there(const Candidate& candidate, const FramePoints& points, const SE3& T_map_camera) {
  const Vec2 middle = candidate.whole.center();
  const double half_width = 0.5 * kMiddle * candidate.whole.width();
  const double half_height = 0.5 * kMiddle * candidate.whole.height();
  const Box box{middle.x() - half_width, middle.y() - half_height, middle.x() + half_width, middle.y() + half_height};
  const double uneven = kUneven_m + kUnevenShare * candidate.ellipsoid->radius();
  std::size_t known = 0, in_front = 0, in_it = 0, behind = 0;
  for (const SeenPoint& p : points.in(box, kPointsMax)) {
    const double z = p.point_camera.z();
    const std::optional<RayDepths> there =
        ray_depths(*candidate.ellipsoid, T_map_camera.t, T_map_camera.q * Vec3(p.point_camera / z));
    if (!there) continue;
    const double margin = kSigmas * (uneven + depth_sigma_m(z));
    ++known;
    if (z < there->enters - margin) ++in_front;
    if (z <= there->enters + margin) continue;
    ++(z > there->leaves ? behind : in_it);
  }
  if (known < kMinPoints) return DepthThere::kUnknown;
  const auto share = [known](std::size_t count) { return static_cast<double>(count) / static_cast<double>(known); };
  if (share(in_front) > kHiddenShare) return DepthThere::kInFront;
  if (share(behind) > kSeenThroughShare) return DepthThere::kBehind;
  return share(behind + in_it) > kSeenThroughShare ? DepthThere::kInIt : DepthThere::kAtIt;
}

}  // namespace

std::vector<ExpectedLandmark> expected_landmarks(const std::map<std::int64_t, MappedLandmark>& landmarks,
                                                 const Frame& frame, const FramePoints* points, const SE3& T_map_camera,
                                                 const AssociationFrame& associations, double least_share) {
  const Mat34 P = projection_matrix(frame.camera, T_map_camera);
  const double px = pixel_factor(frame.camera);
  const Box image = frame.camera.image();
  std::vector<Candidate> in_view;
  for (const auto& [id, landmark] : landmarks) {
    if (!landmark.state.ellipsoid || landmark.state.state == LandmarkState::kRetired) continue;
    const Mat3 shape = landmark.state.ellipsoid->shape();
    const Vec3& center = landmark.state.ellipsoid->center();
    const Vec3 axis = P.row(2).head<3>().transpose();
    const double depth = axis.dot(center) + P(2, 3);
    const std::optional<Box> box = project_box(center, shape, P);
    if (!box || depth > kRange_m) continue;
    const Box visible = clip(*box, image);
    if (!visible.is_valid()) continue;
    const double least_area = (points != nullptr ? kPartlyVisibleShare : least_share) * box->area();
    in_view.push_back(
        {id, &*landmark.state.ellipsoid, visible, *box, depth - std::sqrt(std::max(0.0, axis.dot(shape * axis))), depth,
         landmark.sightings.is_hollow(),
         visible.area() > least_area && visible.width() > kMinWidth_px * px && visible.height() > kMinHeight_px * px});
  }
  std::vector<ExpectedLandmark> expected;
  for (const Candidate& candidate : in_view) {
    if (!candidate.is_looked_for) continue;
    const DepthThere there = points != nullptr ? depth_there(candidate, *points, T_map_camera) : DepthThere::kUnknown;
    if (there == DepthThere::kInFront) continue;
    // What depth shows is hidden by nothing, even if it lies on a table whose near side is nearer.
    if (there == DepthThere::kUnknown && is_hidden_by_landmark(candidate, in_view)) continue;
    const bool is_in_it = there == DepthThere::kInIt;
    const bool is_seen_through = there == DepthThere::kBehind || (is_in_it && !candidate.is_hollow);
    if (!is_seen_through && is_hidden_by_other(candidate, associations)) continue;
    if (!is_seen_through && candidate.share() <= least_share) continue;
    expected.push_back({candidate.id, candidate.box.size(), candidate.share(), is_in_it, is_seen_through});
  }
  return expected;
}

double landmark_quality(const MappedLandmark& landmark) {
  const Landmark& state = landmark.state;
  const double from_around = landmark.sightings.is_placed() ? 1.0 : 1.0 - std::exp(-state.baseline_deg / 15.0);
  const double sigma = std::sqrt(std::max(0.0, state.center_covariance.trace() / 3.0));
  return state.mean_iou * from_around * (1.0 - std::exp(-landmark.sightings.seen_s / 0.7)) / (1.0 + sigma / 0.05);
}

LandmarkState life_cycle_state(const MappedLandmark& landmark, const QuadricMapperOptions& options, bool is_movable) {
  const Landmark& state = landmark.state;
  const Sightings& sightings = landmark.sightings;
  const double seen_share = sightings.seen_share();
  // What is hardly ever seen was never there; what was often seen and is no longer has gone. The second counts the
  // sightings missed since, so that an object that is seldom detected is given more time.
  // Where depth shows what lies behind it, it is not; unless that was so while it had boxes, too.
  if (sightings.hole_share() < kTransparentShare && sightings.seen_through_since_s > options.retire_seen_through_s) {
    return LandmarkState::kRetired;
  }
  if ((sightings.expected_s > options.retire_expected_s && seen_share < options.retire_seen_share) ||
      (is_movable && sightings.missed_since_s * sightings.familiar_share() > options.retire_missed_s)) {
    return LandmarkState::kRetired;
  }
  // Every side must have been seen to end, if not at once: what is cut counts. Boxes alone need several directions,
  // depth needs none.
  const auto is_bounded = [&](double share) { return sightings.least_bounded_s() >= share * options.confirm_seen_s; };
  const bool is_known =
      sightings.is_placed()
          ? sightings.placed_s >= options.confirm_seen_s && is_bounded(kBoundedShare) &&
                (sightings.familiar_s() < kFamiliar_s || sightings.familiar_share() >= kFoundAgainShare)
          : sightings.seen_s >= options.confirm_seen_s && is_bounded(kBoundedShareOfBoxes) &&
                state.baseline_deg >= options.confirm_baseline_deg &&
                (sightings.seen_s >= kSurelyThere_s || sightings.views.found_share() >= options.confirm_seen_share);
  const bool confirmed = state.ellipsoid && state.observations >= options.min_views && is_known &&
                         state.mean_iou >= options.confirm_mean_iou && seen_share >= options.confirm_seen_share &&
                         landmark_quality(landmark) >= options.confirm_quality;
  return confirmed ? LandmarkState::kConfirmed : LandmarkState::kCandidate;
}

}  // namespace semantic_topo_loop::core
