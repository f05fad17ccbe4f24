#include "frontend/bundle_adjustment.h"

#include <ceres/ceres.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kDepthGate = 3.0;  ///< sigmas; farther off, a depth is taken to be another surface's

/// right_jacobian of geometry in another order of operations, which decides on a pose's last bit.
Mat3 turn_jacobian(const Vec3& w) {
  const double angle2 = w.squaredNorm();
  const Mat3 W = hat(w);
  if (angle2 < 1e-10) return Mat3::Identity() - 0.5 * W;
  const double angle = std::sqrt(angle2);
  return Mat3::Identity() - (1.0 - std::cos(angle)) / angle2 * W + (angle - std::sin(angle)) / (angle2 * angle) * W * W;
}

/// Reprojection error, and depth error where there is a depth, in sigmas:
///   r = [(s f p.xy / p.z + c - pixel) / sigma_px; (p.z - depth) / sigma_m],  p = exp(d) (T_camera_map x)
/// by the pose's change d = (translation, rotation), the point x and the factor s of the focal lengths f.
template <int kValues>
class ViewError : public ceres::SizedCostFunction<kValues, 6, 3, 1> {
 public:
  ViewError(const Camera& camera, const SE3& T_camera_map, const PoseObservation& observation)
      : camera_(&camera), R_(T_camera_map.rotation()), t_(T_camera_map.t), o_(observation) {}

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const Eigen::Map<const Vec3> translation(parameters[0]), turn(parameters[0] + 3), x(parameters[1]);
    const Vec3 before = R_ * x + t_;
    const Mat3 dR = so3_exp(turn).toRotationMatrix();
    const Vec3 p = dR * before + translation;
    if (p.z() < kMinDepth_m) return false;
    const double z_inverse = 1.0 / p.z(), factor = parameters[2][0];
    Eigen::Map<Eigen::Matrix<double, kValues, 1>> r(residuals);
    r[0] = (factor * camera_->fx * p.x() * z_inverse + camera_->cx - o_.pixel.x()) / o_.pixel_sigma;
    r[1] = (factor * camera_->fy * p.y() * z_inverse + camera_->cy - o_.pixel.y()) / o_.pixel_sigma;
    if (kValues == 3) r[kValues - 1] = (p.z() - o_.depth_m) / o_.depth_sigma_m;
    if (jacobians == nullptr) return true;
    Eigen::Matrix<double, kValues, 3> by_p;
    const double fx = factor * camera_->fx * z_inverse / o_.pixel_sigma;
    const double fy = factor * camera_->fy * z_inverse / o_.pixel_sigma;
    by_p.row(0) << fx, 0.0, -fx * p.x() * z_inverse;
    by_p.row(1) << 0.0, fy, -fy * p.y() * z_inverse;
    if (kValues == 3) by_p.row(kValues - 1) << 0.0, 0.0, 1.0 / o_.depth_sigma_m;
    if (jacobians[0] != nullptr) {
      Eigen::Map<Eigen::Matrix<double, kValues, 6, Eigen::RowMajor>> J(jacobians[0]);
      J.template leftCols<3>() = by_p;
      J.template rightCols<3>() = -by_p * dR * hat(before) * turn_jacobian(turn);
    }
    if (jacobians[1] != nullptr) {
      Eigen::Map<Eigen::Matrix<double, kValues, 3, Eigen::RowMajor>> J(jacobians[1]);
      J = by_p * dR * R_;
    }
    if (jacobians[2] != nullptr) {
      Eigen::Map<Eigen::Matrix<double, kValues, 1>> J(jacobians[2]);
      J.setZero();
      J[0] = fx * p.x() / factor;
      J[1] = fy * p.y() / factor;
    }
    return true;
  }

 private:
  const Camera* camera_;
  Mat3 R_;
  Vec3 t_;
  PoseObservation o_;
};

/// Chooses the keyframes: the nearest by what they see, then those around that see the same points.
class Selection {
 public:
  Selection(const TrackingMap& map, std::int64_t keyframe, const FrontendOptions& options) : map_(&map) {
    constexpr int kMinShared = 15;  // points, as in ORB-SLAM: fewer tie two keyframes too loosely
    const auto free = static_cast<std::size_t>(options.window_keyframes);
    add(keyframe, false);
    for (const auto& [id, shared] : map.covisible(keyframe)) {
      if (problem.poses.size() < free && shared >= kMinShared) add(id, false);
    }
    for (std::size_t pose = 0, count = problem.poses.size(); pose < count; ++pose) {
      for (const std::int64_t id : map.keyframes().at(problem.poses[pose].keyframe).points) add_point(id);
    }
    std::vector<std::int64_t> ids;
    for (const BundleProblem::Point& point : problem.points) ids.push_back(point.id);
    constexpr std::size_t kMaxFixed = 20;  // two for each free one hold it; more cost time
    for (const auto& [id, shared] : map.covisible(ids)) {
      if (problem.poses.size() < free + kMaxFixed) add(id, true);
    }
    // Without a fixed keyframe nothing holds the map in its place.
    const bool is_held =
        std::any_of(problem.poses.begin(), problem.poses.end(), [](const auto& p) { return p.is_fixed; });
    if (!is_held) {
      std::min_element(problem.poses.begin(), problem.poses.end(), [](const auto& a, const auto& b) {
        return a.keyframe < b.keyframe;
      })->is_fixed = true;
    }
  }
  BundleProblem problem;

  void add_views() {
    for (std::size_t i = 0; i < problem.points.size(); ++i) {
      const MapPoint& point = map_->points().at(problem.points[i].id);
      for (const auto& [keyframe, index] : point.views) {
        const auto pose = pose_of_.find(keyframe);
        if (pose == pose_of_.end()) continue;
        const ImageFeature& feature = map_->keyframes().at(keyframe).features.features[static_cast<std::size_t>(index)];
        problem.views.push_back({pose->second, i, observation(feature, point), false});
      }
    }
  }

 private:
  void add(std::int64_t keyframe, bool is_fixed) {
    if (!pose_of_.emplace(keyframe, problem.poses.size()).second) return;
    problem.poses.push_back({keyframe, map_->keyframes().at(keyframe).T_camera_map, is_fixed});
  }
  void add_point(std::int64_t id) {
    if (id < 0 || point_of_.count(id) > 0) return;
    const MapPoint& point = map_->points().at(id);
    if (point.views.size() < 2) return;
    point_of_.emplace(id, problem.points.size());
    problem.points.push_back({id, point.position});
  }

  const TrackingMap* map_;
  std::map<std::int64_t, std::size_t> pose_of_, point_of_;
};

/// Whether the pixel agrees, and whether the depth does.
std::pair<bool, bool> agrees(const Camera& camera, const SE3& T_camera_map, const Vec3& point,
                             const PoseObservation& o) {
  const Vec3 p = T_camera_map * point;
  if (p.z() < kMinDepth_m) return {false, false};
  const bool depth = o.depth_m > 0.0 && std::abs(p.z() - o.depth_m) < kDepthGate * o.depth_sigma_m;
  return {(camera.pixel(p) - o.pixel).squaredNorm() < kPixelGate2 * o.pixel_sigma * o.pixel_sigma, depth};
}

}  // namespace

BundleProblem local_bundle(const TrackingMap& map, std::int64_t keyframe, const FrontendOptions& options) {
  Selection selection(map, keyframe, options);
  selection.add_views();
  return std::move(selection.problem);
}

void solve(const Camera& camera, int iterations, bool with_focal, BundleProblem* bundle) {
  std::vector<std::array<double, 6>> changes(bundle->poses.size());
  std::vector<Vec3> points(bundle->points.size());
  ceres::Problem::Options problem_options;
  problem_options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::HuberLoss loss(std::sqrt(kPixelGate2));
  ceres::Problem problem(problem_options);
  for (std::array<double, 6>& change : changes) change.fill(0.0);
  for (std::size_t i = 0; i < points.size(); ++i) points[i] = bundle->points[i].position;
  double factor = bundle->focal_factor;
  problem.AddParameterBlock(&factor, 1);
  if (!with_focal) problem.SetParameterBlockConstant(&factor);
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (const BundleProblem::View& view : bundle->views) {
    const BundleProblem::Pose& pose = bundle->poses[view.pose];
    Vec3& point = points[view.point];
    if ((pose.T_camera_map * point).z() < 2.0 * kMinDepth_m) continue;
    ceres::CostFunction* error = nullptr;
    if (agrees(camera, pose.T_camera_map, point, view.observation).second) {
      error = new ViewError<3>(camera, pose.T_camera_map, view.observation);
    } else {
      error = new ViewError<2>(camera, pose.T_camera_map, view.observation);
    }
    problem.AddResidualBlock(error, &loss, changes[view.pose].data(), point.data(), &factor);
    ordering->AddElementToGroup(point.data(), 0);
    ordering->AddElementToGroup(changes[view.pose].data(), 1);
  }
  for (std::size_t i = 0; i < changes.size(); ++i) {
    if (bundle->poses[i].is_fixed && problem.HasParameterBlock(changes[i].data())) {
      problem.SetParameterBlockConstant(changes[i].data());
    }
  }
  if (problem.NumResidualBlocks() == 0) return;
  // Not among the poses: within a group Ceres orders by address, and this one is on the stack, which lies above the
  // heap in one process and below in another.
  ordering->AddElementToGroup(&factor, 2);
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.linear_solver_ordering = ordering;
  options.num_threads = 1;
  options.max_num_iterations = iterations;
  // Costs at several focal lengths are compared to a fraction of a per cent; poses of a window are refined again with
  // the next keyframe.
  options.function_tolerance = with_focal ? 1e-6 : 1e-4;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  if (!summary.IsSolutionUsable()) return;
  for (std::size_t i = 0; i < changes.size(); ++i) {
    const Eigen::Map<const Vec6> change(changes[i].data());
    if (!bundle->poses[i].is_fixed) {
      bundle->poses[i].T_camera_map = SE3(so3_exp(change.tail<3>()), change.head<3>()) * bundle->poses[i].T_camera_map;
    }
  }
  for (std::size_t i = 0; i < points.size(); ++i) bundle->points[i].position = points[i];
  for (BundleProblem::View& view : bundle->views) {
    view.is_outlier =
        !agrees(camera, bundle->poses[view.pose].T_camera_map, points[view.point], view.observation).first;
  }
  bundle->focal_factor = factor;
  bundle->cost = summary.final_cost;
  bundle->is_solved = true;
}

FocalEstimate& FocalEstimate::operator+=(const FocalEstimate& other) {
  const double sum = information + other.information;
  if (sum > 0.0) log_factor = (information * log_factor + other.information * other.log_factor) / sum;
  information = sum;
  return *this;
}

std::optional<FocalEstimate> estimate_focal_length(const Camera& camera, const BundleProblem& problem) {
  constexpr int kIterations = 20;  // to convergence, unlike those of the window
  BundleProblem beside = problem;
  // Fixed keyframes would hold on to the focal length that they were placed with.
  for (BundleProblem::Pose& pose : beside.poses) pose.is_fixed = false;
  beside.poses.back().is_fixed = true;
  BundleProblem corrected = beside;
  solve(camera, kIterations, true, &corrected);
  const double log_factor = std::log(corrected.focal_factor);
  // What the views say of the focal length is seen away from the best one.
  constexpr double kAside = 0.01;
  const double aside = std::abs(log_factor) > kAside ? 0.0 : log_factor + kAside;
  beside.focal_factor = std::exp(aside);
  solve(camera, kIterations, false, &beside);
  constexpr double kLargest = 0.26;  // a factor of 1.3: no camera is stated that wrongly
  if (!beside.is_solved || !corrected.is_solved || !(corrected.cost > 0.0)) return std::nullopt;
  if (std::abs(log_factor) > kLargest) return std::nullopt;
  const double off = aside - log_factor;
  return FocalEstimate{log_factor, std::max(0.0, beside.cost / corrected.cost - 1.0) / (off * off)};
}

void apply(const BundleProblem& problem, TrackingMap* map) {
  if (!problem.is_solved) return;
  for (const BundleProblem::Pose& pose : problem.poses) {
    if (!pose.is_fixed) map->keyframe(pose.keyframe)->T_camera_map = pose.T_camera_map;
  }
  std::vector<bool> has_lost(problem.points.size(), false);  // a view
  for (const BundleProblem::View& view : problem.views) {
    if (!view.is_outlier) continue;
    map->remove_view(problem.points[view.point].id, problem.poses[view.pose].keyframe);
    has_lost[view.point] = true;
  }
  for (std::size_t i = 0; i < problem.points.size(); ++i) {
    const BundleProblem::Point& point = problem.points[i];
    MapPoint* refined = map->point(point.id);
    if (refined->views.empty()) {
      map->remove_point(point.id);
      continue;
    }
    refined->position = point.position;
    has_lost[i] ? map->refresh(refined) : map->refresh_geometry(refined);
  }
}

}  // namespace semantic_topo_loop::core
