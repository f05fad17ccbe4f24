#include "geometry/plane.h"

#include <Eigen/Eigenvalues>
#include <cmath>
#include <cstdint>
#include <random>

#include "geometry/depth_noise.h"

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

/// The camera is at the origin.
Plane facing_camera(Plane plane) {
  if (plane.offset < 0.0) plane = {-plane.normal, -plane.offset};
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
  return facing_camera(*best);
}

}  // namespace semantic_topo_loop::core
