#include "map/quadric_initialisation.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>

#include "geometry/statistics.h"

namespace semantic_topo_loop::core {
namespace {

using Mat5 = Eigen::Matrix<double, 5, 5>;
using Vec5 = Eigen::Matrix<double, 5, 1>;

constexpr double kCauchyScale_m = 0.05;  // distance from a tangent plane at which its weight is halved
constexpr double kMinConditioning = 1e-5;
constexpr double kDepthRatioMax = 3.0;  // of the axis along the view to the two across it
constexpr double kRadiiAgree = 0.01;    // weight of "half-width = half-height", for sides that no view shows

/// One side of a box, as the plane through the camera and that side: row' (X, r_width, r_height) = offset.
struct TangentPlane {
  Vec5 row;
  double offset = 0.0;
};

void add_planes(const Camera& camera, const BoxView& view, std::vector<TangentPlane>* planes) {
  const Vec4 edges = view.box.edges();
  const std::array<double, 2> focal{camera.fx, camera.fy}, principal{camera.cx, camera.cy};
  for (std::size_t k = 0; k < 4; ++k) {
    if ((view.truncated & (1 << k)) != 0) continue;
    const std::size_t axis = k % 2;
    Vec3 normal_camera = Vec3::Zero();
    normal_camera(static_cast<Eigen::Index>(axis)) = focal[axis];
    normal_camera.z() = principal[axis] - edges(static_cast<Eigen::Index>(k));
    const double inward = k < 2 ? 1.0 : -1.0;
    const Vec3 normal = view.T_world_camera.q * (inward * normal_camera.normalized());
    TangentPlane plane;
    plane.row << normal, (axis == 0 ? -1.0 : 0.0), (axis == 1 ? -1.0 : 0.0);
    plane.offset = normal.dot(view.T_world_camera.t);
    planes->push_back(plane);
  }
}

/// Centre and radii that touch the planes best; nullopt if the centre is not determined.
std::optional<Vec5> solve(const std::vector<TangentPlane>& planes) {
  Vec5 solution = Vec5::Zero();
  std::vector<double> weights(planes.size(), 1.0);
  constexpr int kIterations = 10;
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    Mat5 A = 1e-12 * Mat5::Identity();
    Vec5 b = Vec5::Zero();
    for (std::size_t i = 0; i < planes.size(); ++i) {
      A += weights[i] * planes[i].row * planes[i].row.transpose();
      b += weights[i] * planes[i].offset * planes[i].row;
    }
    Eigen::Matrix2d agree;
    agree << 1.0, -1.0, -1.0, 1.0;
    A.bottomRightCorner<2, 2>() += kRadiiAgree * agree;
    const Mat3 of_center = A.topLeftCorner<3, 3>() - A.topRightCorner<3, 2>() * A.bottomRightCorner<2, 2>().inverse() *
                                                         A.bottomLeftCorner<2, 3>();
    const Eigen::SelfAdjointEigenSolver<Mat3> eigen(of_center);
    if (!(eigen.eigenvalues()(0) > kMinConditioning * eigen.eigenvalues()(2))) return std::nullopt;
    solution = A.ldlt().solve(b);
    for (std::size_t i = 0; i < planes.size(); ++i) {
      const double r = (planes[i].row.dot(solution) - planes[i].offset) / kCauchyScale_m;
      weights[i] = 1.0 / (1.0 + r * r);
    }
  }
  return solution.allFinite() ? std::optional<Vec5>(solution) : std::nullopt;
}

}  // namespace

double parallax_deg(const std::vector<BoxView>& views, const Vec3& point_world) {
  double min_cosine = 1.0;
  std::vector<Vec3> directions;
  directions.reserve(views.size());
  for (const BoxView& view : views) directions.push_back((point_world - view.T_world_camera.t).normalized());
  for (std::size_t i = 0; i < directions.size(); ++i) {
    for (std::size_t j = 0; j < i; ++j) min_cosine = std::min(min_cosine, directions[i].dot(directions[j]));
  }
  return degrees(std::acos(std::clamp(min_cosine, -1.0, 1.0)));
}

std::optional<Ellipsoid> initialise_sphere(const Camera& camera, const std::vector<BoxView>& views) {
  if (views.size() < 2) return std::nullopt;
  std::vector<TangentPlane> planes;
  planes.reserve(4 * views.size());
  for (const BoxView& view : views) add_planes(camera, view, &planes);
  const std::optional<Vec5> solution = solve(planes);
  if (!solution) return std::nullopt;
  const Vec3 center = solution->head<3>();
  const auto behind =
      std::count_if(views.begin(), views.end(), [&](const BoxView& view) { return view.depth(center) < 0.2; });
  const double radius = 0.5 * ((*solution)(3) + (*solution)(4));
  if (static_cast<double>(behind) > 0.1 * static_cast<double>(views.size()) || !(radius > 0.0)) return std::nullopt;
  // Axes of the first camera, not of the world: a fit must not depend on where the odometry's world lies.
  return Ellipsoid{SE3(views.front().T_world_camera.q, center), Vec3::Constant(radius)};
}

std::optional<Ellipsoid> initialise_from_surface(const Camera& camera, const BoxView& view, double size_prior_m) {
  if (!view.surface || view.surface->empty() || view.truncated != 0 || !view.box.is_valid()) return std::nullopt;
  std::vector<double> z;
  z.reserve(view.surface->size());
  for (const Eigen::Vector3f& point : *view.surface) z.push_back(static_cast<double>(point.z()));
  const double surface_depth = median(std::move(z));
  if (!(surface_depth > 0.0)) return std::nullopt;
  const double half_width = 0.5 * view.box.width() * surface_depth / camera.fx;
  const double half_height = 0.5 * view.box.height() * surface_depth / camera.fy;
  const double symmetric = std::sqrt(half_width * half_height);
  double half_depth = symmetric;
  if (size_prior_m > 0.0) {
    const double of_class = std::pow(0.5 * size_prior_m, 3.0) / (half_width * half_height);
    half_depth = std::clamp(std::sqrt(symmetric * of_class), symmetric / kDepthRatioMax, symmetric * kDepthRatioMax);
  }
  const Vec3 center_camera = camera.ray(view.box.center()) * (surface_depth + half_depth);
  return Ellipsoid{SE3(view.T_world_camera.q, view.T_world_camera * center_camera),
                   Vec3(half_width, half_height, half_depth)};
}

}  // namespace semantic_topo_loop::core
