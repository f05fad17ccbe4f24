#include "map/landmark_fitter.h"

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

constexpr double kMinDepth_m = 0.2;        // of a centre: no camera of a robot sees an object whole from nearer
constexpr int kMinNewViews = 5;            // before the next fit, so that a young landmark is not fitted in every frame
constexpr double kCauchyScale_m = 0.05;    // distance from a tangent plane at which its weight is halved
constexpr double kMinConditioning = 1e-5;  // smallest over largest: about the square of the parallax, 0.2 deg
constexpr double kDepthRatioMax = 3.0;     // of the axis along the view to the two across it
constexpr double kRadiiAgree = 0.01;       // weight of "half-width = half-height", for sides that no view shows

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
  constexpr int kIterations = 10;  // of reweighting: a fixed number
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
      std::count_if(views.begin(), views.end(), [&](const BoxView& view) { return view.depth(center) < kMinDepth_m; });
  const double radius = 0.5 * ((*solution)(3) + (*solution)(4));
  if (static_cast<double>(behind) > 0.1 * static_cast<double>(views.size()) || !(radius > 0.0)) return std::nullopt;
  // Axes of the first camera, not of the world: a fit must not depend on where the odometry's world lies.
  return Ellipsoid{SE3(views.front().T_world_camera.q, center), Vec3::Constant(radius)};
}

std::optional<Ellipsoid> initialise_from_depth(const Camera& camera, const BoxView& view, double size_prior_m) {
  if (!(view.near_m > 0.0) || !view.box.is_valid()) return std::nullopt;
  const double half_width = 0.5 * view.box.width() * view.near_m / camera.fx;
  const double half_height = 0.5 * view.box.height() * view.near_m / camera.fy;
  const double symmetric = std::sqrt(half_width * half_height);
  double half_depth = symmetric;
  if (size_prior_m > 0.0) {
    const double of_class = std::pow(0.5 * size_prior_m, 3.0) / (half_width * half_height);
    half_depth = std::clamp(std::sqrt(symmetric * of_class), symmetric / kDepthRatioMax, symmetric * kDepthRatioMax);
  }
  const Vec3 semi_axes(half_width, half_height, half_depth);
  const Vec3 center_camera = camera.ray(view.box.center()) * (view.near_m + near_side_m(semi_axes.minCoeff()));
  return Ellipsoid{SE3(view.T_world_camera.q, view.T_world_camera * center_camera), semi_axes};
}

bool LandmarkFitter::fit(const ViewSource& source, MappedLandmark* landmark) const {
  Landmark& state = landmark->state;
  landmark->next_fit_at =
      state.observations + std::max(kMinNewViews, static_cast<int>(options_.refit_growth * state.observations));
  const std::vector<BoxView> views = fit_views(source, *landmark);
  const bool has_depth = std::any_of(views.begin(), views.end(), [](const BoxView& view) { return view.near_m > 0.0; });
  if (!has_depth && static_cast<int>(views.size()) < options_.min_views) return false;
  const std::optional<Ellipsoid> initial = state.ellipsoid ? state.ellipsoid : start(source.camera(), views, state);
  if (!initial) return false;
  const std::optional<QuadricFit> fit = refine_quadric(source.camera(), views, *initial);
  if (!fit || !is_sane(*fit, state.class_id)) return false;
  state.ellipsoid = fit->ellipsoid;
  state.center_covariance = fit->center_covariance;
  state.mean_iou = fit->mean_iou;
  state.baseline_deg = parallax_deg(views, fit->ellipsoid.center());
  state.anchor_keyframe_id = landmark->observations[landmark->observations.size() / 2].keyframe_id;
  return true;
}

/// From the depth inside one box if there is any, else from several boxes with parallax.
std::optional<Ellipsoid> LandmarkFitter::start(const Camera& camera, const std::vector<BoxView>& views,
                                               const Landmark& state) const {
  const ObjectClass* object_class = classes_.find(state.class_id);
  for (const bool is_cut : {false, true}) {
    for (auto view = views.rbegin(); view != views.rend(); ++view) {
      if ((view->truncated != 0) != is_cut) continue;
      const std::optional<Ellipsoid> ellipsoid =
          initialise_from_depth(camera, *view, object_class != nullptr ? object_class->size_prior_m : 0.0);
      if (ellipsoid) return ellipsoid;
    }
  }
  if (static_cast<int>(views.size()) < options_.min_views) return std::nullopt;
  const std::optional<Ellipsoid> sphere = initialise_sphere(camera, views);
  return sphere && parallax_deg(views, sphere->center()) >= options_.min_baseline_deg ? sphere : std::nullopt;
}

/// Boxes of the landmark's class or one confused with it, whole ones first; what the image border cuts fills up, since
/// of a large object seen from near there may be nothing else.
std::vector<BoxView> LandmarkFitter::fit_views(const ViewSource& source, const MappedLandmark& landmark) const {
  std::vector<Observation> whole, cut;
  for (const Observation& observation : landmark.observations) {
    if (!classes_.confusable(observation.class_id, landmark.state.class_id)) continue;
    (observation.view.truncated == 0 ? whole : cut).push_back(observation);
  }
  const auto wanted = static_cast<std::size_t>(options_.fit_views_max);
  std::vector<BoxView> views = source.views(spread(whole, wanted));
  if (views.size() < wanted) {
    const std::vector<BoxView> more = source.views(spread(cut, wanted - views.size()));
    views.insert(views.end(), more.begin(), more.end());
  }
  return views;
}

bool LandmarkFitter::is_sane(const QuadricFit& fit, int class_id) const {
  const ObjectClass* object_class = classes_.find(class_id);
  if (object_class != nullptr && object_class->size_prior_m > 0.0) {
    const double ratio = 2.0 * fit.ellipsoid.radius() / object_class->size_prior_m;
    if (ratio > options_.size_prior_factor || ratio * options_.size_prior_factor < 1.0) return false;
  }
  return fit.median_depth_m > kMinDepth_m && fit.median_depth_m < options_.max_depth_m &&
         fit.ellipsoid.semi_axes.maxCoeff() < options_.max_semi_axis_m && fit.mean_iou > options_.min_fit_iou;
}

}  // namespace semantic_topo_loop::core
