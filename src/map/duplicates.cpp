#include "map/duplicates.h"

#include <algorithm>

#include "geometry/statistics.h"
#include "semantic_topo_loop/geometry/quadric.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::size_t kVotingViews = 30;
constexpr double kMinReach_m = 0.25;
constexpr double kPartInside = 0.7, kPartViews = 0.3;

struct Overlap {
  double iou = 0.0;     ///< of b's boxes with a's projection, median
  double inside = 0.0;  ///< share of b's boxes inside a's projection, median
};

Overlap overlap(const MappedLandmark& a, const MappedLandmark& b, const ViewSource& source) {
  std::vector<Observation> whole;
  for (const Observation& observation : b.observations) {
    if (observation.truncated == 0) whole.push_back(observation);
  }
  const Camera& camera = source.camera();
  const Mat3 shape = a.state.ellipsoid->shape();
  std::vector<double> ious, insides;
  for (const BoxView& view : source.views(spread(whole.empty() ? b.observations : whole, kVotingViews))) {
    const std::optional<Box> projected =
        project_box(a.state.ellipsoid->center(), shape, projection_matrix(camera, view.T_world_camera));
    const Box seen = clip(view.box, camera.width, camera.height);
    const Box box = projected ? clip(*projected, camera.width, camera.height) : Box{};
    ious.push_back(iou(box, seen));
    insides.push_back(seen.area() > 0.0 ? intersection_area(box, seen) / seen.area() : 0.0);
  }
  return {median(ious), median(insides)};
}

}  // namespace

double DuplicateTest::reach_m(const Ellipsoid& a, const Ellipsoid& b) {
  return std::max(kMinReach_m, a.semi_axes.maxCoeff() + b.semi_axes.maxCoeff());
}

bool DuplicateTest::is_duplicate(const MappedLandmark& a, const MappedLandmark& b, const ViewSource& views) const {
  const bool same = a.state.class_id == b.state.class_id;
  if (!same && !classes_.confusable(a.state.class_id, b.state.class_id)) return false;
  const double distance = (a.state.ellipsoid->center() - b.state.ellipsoid->center()).norm();
  if (distance > reach_m(*a.state.ellipsoid, *b.state.ellipsoid)) return false;
  const auto beside = a.seen_beside.find(b.state.id);
  const int common = beside == a.seen_beside.end() ? 0 : beside->second;
  const bool vetoed = common >= options_.merge_veto_share * b.state.observations;
  const Overlap o = overlap(a, b, views);
  if (!same) return o.iou > options_.merge_iou_confusable;
  const double closeness = 0.5 * std::min(a.state.ellipsoid->semi_axes.mean(), b.state.ellipsoid->semi_axes.mean());
  return !vetoed && (o.iou > options_.merge_iou || distance < closeness);
}

bool DuplicateTest::is_part(const MappedLandmark& a, const MappedLandmark& b, const ViewSource& views) const {
  if (!classes_.confusable(a.state.class_id, b.state.class_id)) return false;
  if (b.sightings.seen_s >= kPartViews * a.sightings.seen_s) return false;
  const double reach = a.state.ellipsoid->semi_axes.maxCoeff() + b.state.ellipsoid->semi_axes.maxCoeff();
  if ((a.state.ellipsoid->center() - b.state.ellipsoid->center()).norm() > reach) return false;
  return overlap(a, b, views).inside > kPartInside;
}

}  // namespace semantic_topo_loop::core
