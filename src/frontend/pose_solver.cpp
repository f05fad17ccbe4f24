#include "frontend/pose_solver.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <random>

#include "semantic_topo_loop/geometry/alignment.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kDepthGate2 = 3.841;  ///< chi square of one value, 95 %
constexpr int kMinObservations = 6;    ///< three points determine a pose; as many again to tell whether they are right

/// Errors of one observation in units of their sigmas, and their derivatives by a small motion (translation, rotation)
/// of the camera frame, applied from the left.
struct Linearised {
  Vec3 p = Vec3::Zero();  ///< the point in the camera frame
  Vec2 pixel_error = Vec2::Zero();
  double depth_error = 0.0;
  Eigen::Matrix<double, 2, 6> pixel_jacobian;
  Eigen::Matrix<double, 1, 6> depth_jacobian;
};

bool errors(const Camera& camera, const SE3& T_camera_map, const PoseObservation& o, Linearised* out) {
  const Vec3 p = T_camera_map * o.point_map;
  out->p = p;
  if (p.z() < kMinDepth_m) return false;
  out->pixel_error = (camera.pixel(p) - o.pixel) / o.pixel_sigma;
  out->depth_error = o.depth_m > 0.0 ? (p.z() - o.depth_m) / o.depth_sigma_m : 0.0;
  return true;
}

void jacobians(const Camera& camera, const PoseObservation& o, Linearised* out) {
  const Vec3& p = out->p;
  const double inverse_z = 1.0 / p.z();
  // Of the pixel by the point: [u_x 0 u_z; 0 v_y v_z]; of the point by the motion: [I, -hat(p)].
  const double u_x = camera.fx * inverse_z, u_z = -camera.fx * p.x() * inverse_z * inverse_z;
  const double v_y = camera.fy * inverse_z, v_z = -camera.fy * p.y() * inverse_z * inverse_z;
  out->pixel_jacobian << u_x, 0.0, u_z, u_z * p.y(), u_x * p.z() - u_z * p.x(), -u_x * p.y(),  //
      0.0, v_y, v_z, v_z * p.y() - v_y * p.z(), -v_z * p.x(), v_y * p.x();
  out->pixel_jacobian /= o.pixel_sigma;
  if (o.depth_m > 0.0) {
    out->depth_jacobian << 0.0, 0.0, 1.0, p.y(), -p.x(), 0.0;
    out->depth_jacobian /= o.depth_sigma_m;
  } else {
    out->depth_jacobian.setZero();
  }
}

/// Those that are far off lose their say: together they would pull a pose away.
double cauchy_weight(double squared, double gate2) { return gate2 / (gate2 + squared); }

struct NormalEquations {
  Mat6 hessian = Mat6::Zero();  ///< its lower triangle, which is all that its factors are made of
  Vec6 gradient = Vec6::Zero();
  double pixels = 0.0, pixel_squared = 0.0;  ///< count and squared errors of the pixels, by weight
};

NormalEquations accumulate(const Camera& camera, const SE3& T, const std::vector<PoseObservation>& observations,
                           const std::vector<bool>& used, bool is_robust) {
  NormalEquations n;
  for (std::size_t i = 0; i < observations.size(); ++i) {
    Linearised l;
    if (!used[i] || !observations[i].is_trusted || !errors(camera, T, observations[i], &l)) continue;
    jacobians(camera, observations[i], &l);
    const double pixel2 = l.pixel_error.squaredNorm(), depth2 = l.depth_error * l.depth_error;
    const double pixel_weight = is_robust ? cauchy_weight(pixel2, kPixelGate2) : 1.0;
    const double depth_gate = depth2 <= kDepthGate2 ? 1.0 : 0.0;
    const double depth_weight = is_robust ? cauchy_weight(depth2, kDepthGate2) : depth_gate;
    // By its entries: blocks of sizes that are not known to the compiler take twice the time.
    for (int column = 0; column < 6; ++column) {
      const Vec2 pixel = pixel_weight * l.pixel_jacobian.col(column);
      const double depth = depth_weight * l.depth_jacobian[column];
      for (int row = column; row < 6; ++row) {
        n.hessian(row, column) += l.pixel_jacobian.col(row).dot(pixel) + depth * l.depth_jacobian[row];
      }
    }
    n.gradient += pixel_weight * l.pixel_jacobian.transpose() * l.pixel_error +
                  depth_weight * l.depth_jacobian.transpose() * l.depth_error;
    n.pixels += pixel_weight;
    n.pixel_squared += pixel_weight * pixel2;
  }
  return n;
}

/// @return false if the equations are singular
bool iterate(const Camera& camera, const std::vector<PoseObservation>& observations, const std::vector<bool>& used,
             bool is_robust, int iterations, SE3* T) {
  constexpr double kConverged = 1e-6;  // m and rad: a thousandth of a pixel
  constexpr double kSingular = 1e-6;   // pivot, 1/m^2 and 1/rad^2: a sigma of 1 km says nothing
  for (int i = 0; i < iterations; ++i) {
    const NormalEquations n = accumulate(camera, *T, observations, used, is_robust);
    const Eigen::LDLT<Mat6> factor(n.hessian);
    if (factor.info() != Eigen::Success || !(factor.vectorD().minCoeff() > kSingular)) return false;
    const Vec6 step = factor.solve(-n.gradient);
    if (!step.allFinite()) return false;
    *T = SE3(so3_exp(step.tail<3>()), step.head<3>()) * *T;
    if (step.norm() < kConverged) break;
  }
  return true;
}

/// Variance of a pose from the observations within the gate, over the one that their stated sigmas give it. Errors of a
/// blurred image reach beyond the gate: how large they are tells the mean of those below it, which is that of a normal
/// distribution cut off there. Where the cut falls hangs on the pose, which therefore gains less from what is left:
/// asymptotic variance of an M-estimator (Huber, Robust Statistics, 1981) whose influence ends at the gate.
double variance_factor(const NormalEquations& n) {
  constexpr double kMost = 4.0;  // twice the sigmas: wider errors are next to even within the gate
  constexpr double kUsual = 10.0, kUsualMean = 1.685;  // as many that are as stated, with the mean that the gate has
  const double mean = (n.pixel_squared + kUsual * kUsualMean) / (n.pixels + kUsual);
  const auto share_beyond = [](double variance) { return std::exp(-0.5 * kPixelGate2 / variance); };
  double low = 1.0, high = kMost;
  constexpr int kBisections = 20;
  for (int i = 0; i < kBisections; ++i) {
    const double variance = 0.5 * (low + high), beyond = share_beyond(variance);
    const double expected = 2.0 * variance - kPixelGate2 * beyond / (1.0 - beyond);
    (expected < mean ? low : high) = variance;
  }
  const double within = 1.0 - share_beyond(low);
  return low * within / (within - 0.5 * kPixelGate2 / low * (1.0 - within));
}

/// Which observations' pixels the pose explains.
int classify(const Camera& camera, const SE3& T, const std::vector<PoseObservation>& observations, double gate2,
             std::vector<bool>* is_inlier) {
  int inliers = 0;
  for (std::size_t i = 0; i < observations.size(); ++i) {
    Linearised l;
    (*is_inlier)[i] = errors(camera, T, observations[i], &l) && l.pixel_error.squaredNorm() <= gate2;
    inliers += (*is_inlier)[i] ? 1 : 0;
  }
  return inliers;
}

Vec3 measured_point(const Camera& camera, const PoseObservation& o) { return o.depth_m * camera.ray(o.pixel); }

/// Whether two points are as far apart in the image as in the map.
bool same_distance(const Camera& camera, const PoseObservation& a, const PoseObservation& b) {
  const double in_map = (a.point_map - b.point_map).norm();
  const double measured = (measured_point(camera, a) - measured_point(camera, b)).norm();
  constexpr double kGateSigmas = 3.0;
  constexpr double kShare = 0.1;           // what the sigmas, which are those along the rays, leave out
  constexpr double kMinDistance_m = 0.05;  // points close together give no rotation: 1 cm of noise turns them by 11 deg
  const double sigma = std::hypot(a.depth_sigma_m, b.depth_sigma_m);
  return in_map > kMinDistance_m && std::abs(in_map - measured) < kGateSigmas * sigma + kShare * in_map;
}

/// refine_pose, which begins with the observations that are `used`.
std::optional<PoseEstimate> refine(const Camera& camera, const SE3& T_camera_map,
                                   const std::vector<PoseObservation>& observations, std::vector<bool> used) {
  constexpr int kIterations = 6;  // Gauss-Newton converges in 3 to 4 from a motion's guess; twice that while robust
  if (observations.size() < kMinObservations) return std::nullopt;
  PoseEstimate estimate;
  estimate.T_camera_map = T_camera_map;
  estimate.is_inlier = std::move(used);
  SE3* T = &estimate.T_camera_map;
  if (!iterate(camera, observations, estimate.is_inlier, true, 2 * kIterations, T)) return std::nullopt;
  constexpr int kRounds = 2;  // the second looks again at what the first, with other inliers, left out
  for (int round = 0; round < kRounds; ++round) {
    estimate.inliers = classify(camera, *T, observations, kPixelGate2, &estimate.is_inlier);
    if (estimate.inliers < kMinObservations) return std::nullopt;
    if (!iterate(camera, observations, estimate.is_inlier, false, kIterations, T)) return std::nullopt;
  }
  estimate.inliers = classify(camera, *T, observations, kPixelGate2, &estimate.is_inlier);
  const NormalEquations n = accumulate(camera, *T, observations, estimate.is_inlier, false);
  const Eigen::LDLT<Mat6> factor(n.hessian);
  if (estimate.inliers < kMinObservations || factor.info() != Eigen::Success) return std::nullopt;
  estimate.covariance = variance_factor(n) * factor.solve(Mat6::Identity());
  if (!estimate.covariance.allFinite()) return std::nullopt;
  return estimate;
}

}  // namespace

std::optional<PoseEstimate> refine_pose(const Camera& camera, const SE3& T_camera_map,
                                        const std::vector<PoseObservation>& observations) {
  return refine(camera, T_camera_map, observations, std::vector<bool>(observations.size(), true));
}

std::optional<PoseEstimate> find_pose(const Camera& camera, const std::vector<PoseObservation>& observations,
                                      int min_inliers) {
  std::vector<std::size_t> with_depth;
  for (std::size_t i = 0; i < observations.size(); ++i) {
    if (observations[i].depth_m > 0.0) with_depth.push_back(i);
  }
  if (with_depth.size() < 3) return std::nullopt;
  // Of 300 triples one is free of wrong matches with 99 % if a quarter of the matches is right: (1 - 0.25^3)^300 = 0.9
  // %. Triples of other distances than in the map are drawn in vain, and cost little.
  constexpr int kMaxTested = 300, kDraws = 2000;
  constexpr int kLocalRounds = 2, kLocalIterations = 3;
  constexpr double kWideGate2 = 36.0;        // 6 px: three points give a rough pose
  constexpr std::uint64_t kSeed = 20231108;  // any: the same input gives the same pose
  std::mt19937_64 generator(kSeed);
  std::vector<bool> is_inlier(observations.size());
  int best_inliers = 0;
  SE3 best;
  for (int draw = 0, tested = 0; draw < kDraws && tested < kMaxTested; ++draw) {
    std::array<std::size_t, 3> sample{};
    for (std::size_t& index : sample) index = with_depth[generator() % with_depth.size()];
    const PoseObservation &a = observations[sample[0]], &b = observations[sample[1]], &c = observations[sample[2]];
    if (!same_distance(camera, a, b) || !same_distance(camera, b, c) || !same_distance(camera, a, c)) continue;
    const std::optional<Alignment> alignment =
        align_points({measured_point(camera, a), measured_point(camera, b), measured_point(camera, c)},
                     {a.point_map, b.point_map, c.point_map});
    if (!alignment) continue;
    ++tested;
    SE3 candidate = alignment->T_a_b;
    int inliers = classify(camera, candidate, observations, kWideGate2, &is_inlier);
    // A rough pose that is at all good is polished before it is judged.
    for (int round = 0; round < kLocalRounds && inliers >= kMinObservations && 2 * inliers > best_inliers; ++round) {
      SE3 polished = candidate;
      if (!iterate(camera, observations, is_inlier, true, kLocalIterations, &polished)) break;
      const int now = classify(camera, polished, observations, kWideGate2, &is_inlier);
      if (now < inliers) break;
      candidate = polished;
      inliers = now;
    }
    if (inliers <= best_inliers) continue;
    best_inliers = inliers;
    best = candidate;
  }
  if (best_inliers < min_inliers) return std::nullopt;
  classify(camera, best, observations, kWideGate2, &is_inlier);
  std::optional<PoseEstimate> estimate = refine(camera, best, observations, is_inlier);
  if (!estimate || estimate->inliers < min_inliers) return std::nullopt;
  return estimate;
}

}  // namespace semantic_topo_loop::core
