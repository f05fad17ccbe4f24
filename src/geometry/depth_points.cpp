#include "geometry/depth_points.h"

#include <pcl/filters/statistical_outlier_removal.h>
#include <pcl/point_cloud.h>
#include <pcl/point_types.h>
#include <pcl/search/kdtree.h>
#include <pcl/segmentation/extract_clusters.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <utility>

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

using Cloud = pcl::PointCloud<pcl::PointXYZ>;

constexpr std::size_t kMinPoints = 5;    // of an object or a cluster: fewer are noise or a rim
constexpr std::size_t kPointsMax = 400;  // around a box: more make nothing better and every step slower
constexpr double kRing = 0.25;           // of the box's sides, on each side: what lies around the object
constexpr int kPlanesMax = 2;            // table and wall
constexpr int kHypotheses = 40;          // finds a plane of half of the points in 99.5 % of all cases
constexpr double kPlaneShare = 0.3;      // of the points around the box, from which on a plane is the object's support
constexpr double kMiddle = 0.8;          // of the box: the ellipse that a convex object fills
constexpr double kFlatShare = 0.15;      // of the middle above the support, below which the object is flat
constexpr int kSurfaceCells = 3;         // along each side of the box
constexpr double kStrip_px = 10.0;       // along a side, inside of it: two or three points of a frame's grid
constexpr std::size_t kStripPointsMax = 100;  // twenty times those that it takes
constexpr double kOccluderShare = 0.6;  // of what lies outside of a side in one plane, and inside of it behind that

/// 0 in the middle of the box, 1 on the ellipse that touches its sides.
double eccentricity(const Vec2& pixel, const Box& box) {
  const Vec2 offset = pixel - box.center();
  return std::hypot(2.0 * offset.x() / box.width(), 2.0 * offset.y() / box.height());
}

/// What is around and in a box.
struct Neighbourhood {
  std::vector<SeenPoint> inside;
  std::vector<Vec3> around;
};

Neighbourhood look(const FramePoints& points, const Box& box) {
  const double dx = kRing * box.width(), dy = kRing * box.height();
  Neighbourhood result;
  for (const SeenPoint& p : points.in({box.x1 - dx, box.y1 - dy, box.x2 + dx, box.y2 + dy}, kPointsMax)) {
    if (contains(box, p.pixel)) {
      result.inside.push_back(p);
    } else {
      result.around.push_back(p.point_camera);
    }
  }
  return result;
}

const Vec3& position(const Vec3& point) { return point; }
const Vec3& position(const SeenPoint& point) { return point.point_camera; }

template <class Point>
void remove_plane(const Plane& plane, std::vector<Point>* points) {
  const auto lies_in = [&plane](const Point& point) { return plane.holds(position(point)); };
  points->erase(std::remove_if(points->begin(), points->end(), lies_in), points->end());
}

/// The points inside the box that belong to none of the planes that go on around it.
std::vector<SeenPoint> without_supports(Neighbourhood neighbourhood) {
  const auto least = static_cast<std::size_t>(kPlaneShare * static_cast<double>(neighbourhood.around.size()));
  for (int i = 0; i < kPlanesMax && neighbourhood.around.size() > std::max(kMinPoints, least); ++i) {
    const double share = static_cast<double>(least) / static_cast<double>(neighbourhood.around.size());
    const std::optional<Plane> plane = dominant_plane(neighbourhood.around, kHypotheses, share);
    if (!plane) break;
    remove_plane(*plane, &neighbourhood.around);
    remove_plane(*plane, &neighbourhood.inside);
  }
  return std::move(neighbourhood.inside);
}

std::size_t in_middle(const std::vector<SeenPoint>& points, const Box& box) {
  return static_cast<std::size_t>(std::count_if(
      points.begin(), points.end(), [&](const SeenPoint& p) { return eccentricity(p.pixel, box) < kMiddle; }));
}

Cloud::Ptr to_cloud(const std::vector<SeenPoint>& points) {
  Cloud::Ptr cloud(new Cloud);
  for (const SeenPoint& p : points) {
    const Eigen::Vector3f q = p.point_camera.cast<float>();
    cloud->push_back({q.x(), q.y(), q.z()});
  }
  return cloud;
}

Cloud::Ptr without_outliers(const Cloud::Ptr& cloud) {
  pcl::StatisticalOutlierRemoval<pcl::PointXYZ> filter;
  filter.setInputCloud(cloud);
  filter.setMeanK(static_cast<int>(kMinPoints) - 1);
  filter.setStddevMulThresh(2.0);
  Cloud::Ptr filtered(new Cloud);
  filter.filter(*filtered);
  return filtered;
}

std::vector<pcl::PointIndices> clusters(const Cloud::Ptr& cloud, const Camera& camera, const Box& box) {
  double mean_depth = 0.0;
  for (const pcl::PointXYZ& p : *cloud) mean_depth += p.z / static_cast<double>(cloud->size());
  pcl::search::KdTree<pcl::PointXYZ>::Ptr tree(new pcl::search::KdTree<pcl::PointXYZ>);
  tree->setInputCloud(cloud);
  pcl::EuclideanClusterExtraction<pcl::PointXYZ> clustering;
  // Surfaces within a third of the object's own size belong together.
  clustering.setClusterTolerance(std::max(0.01, box.size() * mean_depth / camera.fx / 3.0));
  clustering.setMinClusterSize(static_cast<int>(kMinPoints));
  clustering.setSearchMethod(tree);
  clustering.setInputCloud(cloud);
  std::vector<pcl::PointIndices> found;
  clustering.extract(found);
  return found;
}

/// How much of the box's middle a cluster fills.
double weight(const Cloud& cloud, const pcl::PointIndices& cluster, const Camera& camera, const Box& box) {
  double sum = 0.0;
  for (const int index : cluster.indices) {
    const pcl::PointXYZ& p = cloud[static_cast<std::size_t>(index)];
    const Vec2 pixel(camera.fx * p.x / p.z + camera.cx, camera.fy * p.y / p.z + camera.cy);
    const double e = eccentricity(pixel, box);
    sum += std::max(0.0, 1.0 - e * e);
  }
  return sum;
}

std::vector<Vec3> middle_cluster(const std::vector<SeenPoint>& seen, const Camera& camera, const Box& box) {
  const Cloud::Ptr cloud = without_outliers(to_cloud(seen));
  std::vector<Vec3> points;
  if (cloud->size() < kMinPoints) return points;
  double most = 0.0;
  for (const pcl::PointIndices& cluster : clusters(cloud, camera, box)) {
    const double value = weight(*cloud, cluster, camera, box);
    if (value <= most) continue;
    most = value;
    points.clear();
    for (const int index : cluster.indices) {
      const pcl::PointXYZ& p = (*cloud)[static_cast<std::size_t>(index)];
      points.emplace_back(p.x, p.y, p.z);
    }
  }
  return points;
}

/// The strips along a side, inside and outside of the box.
/// @param side of the edges (x1, y1, x2, y2)
std::pair<Box, Box> strips(const Box& box, int side) {
  const int other_side = (side + 2) % 4;
  const double inward = side < 2 ? 1.0 : -1.0;
  const double length = side % 2 == 0 ? box.width() : box.height();
  Vec4 inside = box.edges(), outside = box.edges();
  inside(other_side) = inside(side) + inward * kStrip_px;
  outside(other_side) = outside(side);
  outside(side) -= inward * std::max(2.0 * kStrip_px, kRing * length);
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
  if (!box.is_valid() || std::min(box.width(), box.height()) < 2.0 * kStrip_px) return hidden;
  for (int side = 0; side < 4; ++side) {
    const auto [inside, outside] = strips(box, side);
    if (is_behind(points.in(inside, kStripPointsMax), points.in(outside, kStripPointsMax))) {
      hidden |= static_cast<std::uint8_t>(1 << side);
    }
  }
  return hidden;
}

std::vector<Vec3> object_points(const FramePoints& points, const Box& box) {
  if (!box.is_valid()) return {};
  Neighbourhood neighbourhood = look(points, box);
  if (neighbourhood.inside.size() < kMinPoints) return {};
  std::vector<SeenPoint> all = neighbourhood.inside;
  const std::vector<SeenPoint> above = without_supports(std::move(neighbourhood));
  const double share = static_cast<double>(in_middle(above, box)) / static_cast<double>(in_middle(all, box) + 1);
  if (above.size() >= kMinPoints && share >= kFlatShare) return middle_cluster(above, points.camera(), box);
  all.erase(
      std::remove_if(all.begin(), all.end(), [&](const SeenPoint& p) { return eccentricity(p.pixel, box) >= kMiddle; }),
      all.end());
  return all.size() < kMinPoints ? std::vector<Vec3>{} : middle_cluster(all, points.camera(), box);
}

std::shared_ptr<const Surface> make_surface(const std::vector<Vec3>& object_points_camera, const Camera& camera,
                                            const Box& box) {
  std::array<std::vector<Vec3>, kSurfaceCells * kSurfaceCells> cells;
  for (const Vec3& p : object_points_camera) {
    const Vec2 pixel = camera.pixel(p);
    if (eccentricity(pixel, box) >= kMiddle) continue;
    const auto cell = [](double share) {
      return std::clamp(static_cast<int>(share * kSurfaceCells), 0, kSurfaceCells - 1);
    };
    const int column = cell((pixel.x() - box.x1) / box.width()), row = cell((pixel.y() - box.y1) / box.height());
    cells[static_cast<std::size_t>(row * kSurfaceCells + column)].push_back(p);
  }
  Surface surface;
  for (std::vector<Vec3>& cell : cells) {
    if (cell.empty()) continue;
    const auto middle = cell.begin() + static_cast<std::ptrdiff_t>(cell.size() / 2);
    std::nth_element(cell.begin(), middle, cell.end(), [](const Vec3& a, const Vec3& b) { return a.z() < b.z(); });
    surface.push_back(middle->cast<float>());
  }
  return surface.empty() ? nullptr : std::make_shared<const Surface>(std::move(surface));
}

}  // namespace semantic_topo_loop::core
