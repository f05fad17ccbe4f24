#include "geometry/depth_points.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <utility>

#include "geometry/statistics.h"
#include "geometry/wide_image.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::uint64_t kSeed = 1;      // any: the same points give the same plane
constexpr std::size_t kMinInliers = 6;  // three that define it and as many that agree
constexpr double kMinSpread = 1e-6;     // of the inliers' second direction, m^2: three points in a row are no plane

std::optional<Plane> through(const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 normal = (b - a).cross(c - a);
  const double length = normal.norm();
  if (!(length > kMinSpread)) return std::nullopt;
  Plane plane{normal / length, 0.0};
  plane.offset = -plane.normal.dot(a);
  return plane;
}

std::optional<Plane> least_squares(const std::vector<Vec3>& points, const std::vector<double>& tolerances,
                                   const Plane& start) {
  Vec3 sum = Vec3::Zero();
  Mat3 products = Mat3::Zero();
  std::size_t count = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (std::abs(start.distance(points[i])) > tolerances[i]) continue;
    sum += points[i];
    products += points[i] * points[i].transpose();
    ++count;
  }
  if (count < kMinInliers) return std::nullopt;
  const double n = static_cast<double>(count);
  const Vec3 mean = sum / n;
  const Eigen::SelfAdjointEigenSolver<Mat3> solver(products / n - mean * mean.transpose());
  if (!(solver.eigenvalues()(1) > kMinSpread)) return std::nullopt;
  Plane plane{solver.eigenvectors().col(0), 0.0};
  plane.offset = -plane.normal.dot(mean);
  return plane;
}

constexpr int kCell_px = 16;  // a few points of a depth image in steps of 4 to 8 px

int cells(int size_px) { return std::max(1, (size_px + kCell_px - 1) / kCell_px); }

bool contains(const Box& box, const Vec2& pixel) {
  return pixel.x() >= box.x1 && pixel.x() <= box.x2 && pixel.y() >= box.y1 && pixel.y() <= box.y2;
}

constexpr std::size_t kMinPoints = 5;         // of an object: fewer are noise or a rim
constexpr std::size_t kPointsMax = 300;       // of a box: more make nothing better and every step slower
constexpr double kRing = 0.25;                // of the box's sides, on each side: what lies around the object
constexpr int kHypotheses = 40;               // finds a plane of half of the points in 99.5 % of all cases
constexpr double kMiddle = 0.8;               // of the box: the ellipse that a convex object fills
constexpr double kNearShare = 0.35;           // of the points in it: less than the part that anything but a frame fills
constexpr double kReach = 0.5;                // of the box's longer side, before and behind that
constexpr double kBehindShare = 0.3;          // of the points in it, behind that: then these may be the object's
constexpr double kPlaneShare = 0.4;           // of a layer, in one plane: a table top with what lies on it
constexpr double kGoesOnShare = 0.08;         // of what lies around the box, in that plane
constexpr double kStrip_px = 10.0;            // along a side, inside of it, at a width of 640: two or three points
constexpr std::size_t kStripPointsMax = 100;  // twenty times those that it takes
constexpr double kOccluderShare = 0.6;  // of what lies outside of a side in one plane, and inside of it behind that

/// 0 in the middle of the box, 1 on the ellipse that touches its sides.
double eccentricity(const Vec2& pixel, const Box& box) {
  const Vec2 offset = pixel - box.center();
  return std::hypot(2.0 * offset.x() / box.width(), 2.0 * offset.y() / box.height());
}

double longer_side(const Box& box, const Camera& camera) {
  return std::max(box.width() / camera.fx, box.height() / camera.fy);
}

/// Points about one depth.
struct Layer {
  std::vector<Vec3> points, behind;
};

/// About the depth that kNearShare of the points do not reach.
/// @param reach before and behind that, as a share of the depth
Layer nearest_layer(const std::vector<Vec3>& points, double reach) {
  Layer layer;
  if (points.empty()) return layer;
  std::vector<double> depths;
  depths.reserve(points.size());
  for (const Vec3& point : points) depths.push_back(point.z());
  const auto near = depths.begin() + static_cast<std::ptrdiff_t>(kNearShare * static_cast<double>(depths.size()));
  std::nth_element(depths.begin(), near, depths.end());
  for (const Vec3& point : points) {
    const double beyond_m = point.z() - *near, reach_m = reach * *near;
    if (std::abs(beyond_m) <= reach_m) layer.points.push_back(point);
    if (beyond_m > reach_m) layer.behind.push_back(point);
  }
  return layer;
}

/// The strips along a side, inside and outside of the box.
/// @param side of the edges (x1, y1, x2, y2)
std::pair<Box, Box> strips(const Box& box, int side, double width_px) {
  const int other_side = (side + 2) % 4;
  const double inward = side < 2 ? 1.0 : -1.0;
  const double length = side % 2 == 0 ? box.width() : box.height();
  Vec4 inside = box.edges(), outside = box.edges();
  inside(other_side) = inside(side) + inward * width_px;
  outside(other_side) = outside(side);
  outside(side) -= inward * std::max(2.0 * width_px, kRing * length);
  return {{inside(0), inside(1), inside(2), inside(3)}, {outside(0), outside(1), outside(2), outside(3)}};
}

/// Whether what is inside lies behind the plane of what is outside: a table that an object stands on, and a wall before
/// which it stands, lie behind the object.
bool is_behind(const std::vector<SeenPoint>& inside, const std::vector<SeenPoint>& outside) {
  if (inside.size() < kMinPoints || outside.size() < 2 * kMinPoints) return false;
  std::vector<Vec3> around;
  around.reserve(outside.size());
  for (const SeenPoint& p : outside) around.push_back(p.point_camera);
  const std::optional<Plane> plane = dominant_plane(around, kHypotheses, kOccluderShare);
  if (!plane) return false;
  const auto behind = std::count_if(inside.begin(), inside.end(), [&](const SeenPoint& p) {
    return plane->distance(p.point_camera) < -plane_tolerance_m(p.point_camera.z());
  });
  return static_cast<double>(behind) > kOccluderShare * static_cast<double>(inside.size());
}

/// Whether the plane that holds most of a layer goes on outside of the box: an object ends with its box, a desk that
/// stands before it does not.
bool goes_on_outside(const std::vector<Vec3>& layer, const FramePoints& points, const Box& box) {
  const std::optional<Plane> plane = dominant_plane(layer, kHypotheses, kPlaneShare);
  if (!plane) return false;
  const double margin_x = kRing * box.width(), margin_y = kRing * box.height();
  std::size_t around = 0, on_plane = 0;
  for (const SeenPoint& p :
       points.in({box.x1 - margin_x, box.y1 - margin_y, box.x2 + margin_x, box.y2 + margin_y}, kPointsMax)) {
    if (contains(box, p.pixel)) continue;
    ++around;
    on_plane += plane->holds(p.point_camera) ? 1 : 0;
  }
  return static_cast<double>(on_plane) > kGoesOnShare * static_cast<double>(around);
}

}  // namespace

double plane_tolerance_m(double depth_m) {
  constexpr double kUneven_m = 0.005;  // of table tops and walls, with what lies flat on them
  return kUneven_m + 2.5 * depth_sigma_m(depth_m);
}

std::optional<Plane> dominant_plane(const std::vector<Vec3>& points, int hypotheses, double min_share) {
  if (points.size() < kMinInliers) return std::nullopt;
  std::vector<double> tolerances;
  tolerances.reserve(points.size());
  for (const Vec3& point : points) tolerances.push_back(plane_tolerance_m(point.z()));
  std::mt19937_64 engine(kSeed);
  const auto draw = [&]() -> const Vec3& { return points[engine() % points.size()]; };
  const auto inliers = [&](const Plane& plane) {
    std::size_t count = 0;
    for (std::size_t i = 0; i < points.size(); ++i) {
      count += std::abs(plane.distance(points[i])) <= tolerances[i] ? 1 : 0;
    }
    return count;
  };
  std::optional<Plane> best;
  std::size_t most = 0;
  for (int i = 0; i < hypotheses; ++i) {
    const Vec3 &a = draw(), &b = draw(), &c = draw();
    const std::optional<Plane> plane = through(a, b, c);
    const std::size_t count = plane ? inliers(*plane) : 0;
    if (count <= most) continue;
    most = count;
    best = plane;
  }
  for (int i = 0; i < 2 && best; ++i) best = least_squares(points, tolerances, *best);
  if (!best || static_cast<double>(inliers(*best)) < min_share * static_cast<double>(points.size())) {
    return std::nullopt;
  }
  if (best->offset < 0.0) best = Plane{-best->normal, -best->offset};  // the camera is at the origin
  return best;
}

FramePoints::FramePoints(const std::vector<Vec3>& points_camera, const Camera& camera)
    : camera_(camera), grid_(cells(camera.width), cells(camera.height), kCell_px) {
  std::vector<SeenPoint> seen;
  seen.reserve(points_camera.size());
  for (const Vec3& p : points_camera) {
    if (!p.allFinite() || !(p.z() > 0.0)) continue;
    const Vec2 pixel = camera.pixel(p);
    if (pixel.allFinite()) seen.push_back({pixel, p});
  }
  grid_.sort(seen.size(), [&seen](std::size_t i) -> const Vec2& { return seen[i].pixel; });
  points_.reserve(seen.size());
  for (const std::uint32_t i : grid_.order()) points_.push_back(seen[i]);
}

std::vector<SeenPoint> FramePoints::in(const Box& box, std::size_t count_max) const {
  std::vector<SeenPoint> found;
  if (!box.is_valid() || count_max == 0) return found;
  std::size_t candidates = 0;
  grid_.for_each_row(box, [&](std::uint32_t begin, std::uint32_t end) { candidates += end - begin; });
  // Every n-th; n is odd, so that it does not fall in step with the lines of an even grid.
  std::size_t step = (candidates + count_max - 1) / count_max;
  if (step > 1) step |= 1;
  std::size_t k = 0;
  grid_.for_each_row(box, [&](std::uint32_t begin, std::uint32_t end) {
    for (std::uint32_t i = begin; i < end; ++i, ++k) {
      if (k % step == 0 && contains(box, points_[i].pixel)) found.push_back(points_[i]);
    }
  });
  return found;
}

std::uint8_t hidden_sides(const FramePoints& points, const Box& box) {
  std::uint8_t hidden = 0;
  const double width_px = kStrip_px * pixel_factor(points.camera());
  if (!box.is_valid() || std::min(box.width(), box.height()) < 2.0 * width_px) return hidden;
  for (int side = 0; side < 4; ++side) {
    const auto [inside, outside] = strips(box, side, width_px);
    if (is_behind(points.in(inside, kStripPointsMax), points.in(outside, kStripPointsMax))) {
      hidden |= static_cast<std::uint8_t>(1 << side);
    }
  }
  return hidden;
}

std::vector<std::vector<Vec3>> object_layers(const FramePoints& points, const Box& box) {
  std::vector<Vec3> middle;
  for (const SeenPoint& p : points.in(box, kPointsMax)) {
    if (eccentricity(p.pixel, box) < kMiddle) middle.push_back(p.point_camera);
  }
  std::vector<std::vector<Vec3>> layers;
  if (middle.size() < kMinPoints) return layers;
  const double reach = kReach * longer_side(box, points.camera());
  Layer near = nearest_layer(middle, reach);
  if (near.points.size() < kMinPoints) return layers;
  layers.push_back(std::move(near.points));
  if (static_cast<double>(near.behind.size()) < kBehindShare * static_cast<double>(middle.size())) return layers;
  if (!goes_on_outside(layers.front(), points, box)) return layers;
  Layer far = nearest_layer(near.behind, reach);
  if (far.points.size() >= kMinPoints) layers.push_back(std::move(far.points));
  return layers;
}

bool is_one_thing(const Placement& a, const Placement& b) {
  constexpr double kOnePlace = 0.4, kOneSize = 0.5;
  const auto [smaller, larger] = std::minmax(a.size_m, b.size_m);
  return smaller > kOneSize * larger && (a.center - b.center).norm() < kOnePlace * smaller;
}

std::vector<Placement> place(const FramePoints& points, const Box& box) {
  std::vector<Placement> placements;
  for (const std::vector<Vec3>& layer : object_layers(points, box)) {
    std::vector<double> depths;
    depths.reserve(layer.size());
    for (const Vec3& point : layer) depths.push_back(point.z());
    const double depth = median(std::move(depths));
    placements.push_back({depth * points.camera().ray(box.center()), depth * longer_side(box, points.camera())});
  }
  return placements;
}

}  // namespace semantic_topo_loop::core
