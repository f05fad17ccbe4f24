#include "geometry/up_estimator.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <vector>

#include "geometry/depth_points.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::int64_t kSampleInterval_ns = 90'000'000;  ///< as the default of loop.frame_interval_s
/// Mean square of the x axes' vertical components: a roll of about 10 deg.
constexpr double kMaxRollVariance = 0.03;
/// Mean square along the second direction: the camera has turned by some 20 deg about the vertical.
constexpr double kMinYawVariance = 0.08;

constexpr std::size_t kPlanePoints = 500;  // of a frame: enough for its largest surface
constexpr int kHypotheses = 60;  // finds a plane of half of the points in 99.9 % of the frames, of a third in 90 %
constexpr double kMinPlaneShare = 0.2;  // of the points: a desk between a wall and what stands on it
constexpr double kMinUpward = 0.5;  // of a level surface's normal along image-up: the camera is tilted by up to 60 deg
constexpr double kMaxSideways = 0.26;  // of it along the image's x axis: a roll of 15 deg
constexpr double kAgreeing = 0.985;    // cosine: votes within 10 deg agree
constexpr std::size_t kMinVotes = 5;   // half a second of frames

/// The largest surface of a frame, if it may be level. Camera frame.
std::optional<Vec3> level_surface(const std::vector<Vec3>& points_camera) {
  std::vector<Vec3> points;
  points.reserve(kPlanePoints + 1);
  std::size_t step = points_camera.size() / kPlanePoints + 1;
  if (step > 1) step |= 1;  // not in step with the lines of an even grid
  for (std::size_t i = 0; i < points_camera.size(); i += step) {
    if (points_camera[i].allFinite() && points_camera[i].z() > 0.0) points.push_back(points_camera[i]);
  }
  constexpr int kSurfaces = 2;  // the largest may be a wall
  for (int i = 0; i < kSurfaces; ++i) {
    const std::optional<Plane> plane = dominant_plane(points, kHypotheses, kMinPlaneShare);
    if (!plane) return std::nullopt;
    const Vec3& n = plane->normal;
    if (-n.y() > kMinUpward && std::abs(n.x()) < kMaxSideways) return n;
    const auto lies_in = [&plane](const Vec3& p) { return plane->holds(p); };
    points.erase(std::remove_if(points.begin(), points.end(), lies_in), points.end());
  }
  return std::nullopt;
}

}  // namespace

UpEstimator::UpEstimator(double span_s) : span_ns_(std::llround(1e9 * span_s)) {}

void UpEstimator::push(const Frame& frame) {
  if (frame.is_break) samples_.clear();
  if (!samples_.empty() && frame.stamp_ns - samples_.back().stamp_ns < kSampleInterval_ns) return;
  samples_.push_back({frame.stamp_ns, frame.T_odom_camera.q, std::nullopt});
  if (frame.points_camera) {
    if (const std::optional<Vec3> normal = level_surface(*frame.points_camera)) {
      samples_.back().level_normal_odom = frame.T_odom_camera.q * *normal;
    }
  }
  while (frame.stamp_ns - samples_.front().stamp_ns > span_ns_) samples_.pop_front();
}

/// The mean of the votes that agree with the one most others agree with; camera frame.
std::optional<Vec3> UpEstimator::level_normal(const Mat3& R_camera_odom) const {
  std::vector<Vec3> votes;
  for (const Sample& sample : samples_) {
    if (sample.level_normal_odom) votes.push_back(*sample.level_normal_odom);
  }
  if (votes.size() < kMinVotes) return std::nullopt;
  std::size_t most = 0;
  Vec3 best = Vec3::Zero();
  for (const Vec3& vote : votes) {
    Vec3 sum = Vec3::Zero();
    std::size_t count = 0;
    for (const Vec3& other : votes) {
      if (vote.dot(other) < kAgreeing) continue;
      sum += other;
      ++count;
    }
    if (count <= most) continue;
    most = count;
    best = sum;
  }
  if (2 * most <= votes.size()) return std::nullopt;
  return R_camera_odom * best.normalized();
}

UpDirection UpEstimator::estimate(const Quaternion& q_odom_camera) const {
  UpDirection up;
  if (samples_.empty()) return up;
  const Mat3 R_camera_odom = q_odom_camera.conjugate().toRotationMatrix();
  if (const std::optional<Vec3> normal = level_normal(R_camera_odom)) return {*normal, true};
  Mat3 scatter = Mat3::Zero();
  Vec3 image_up = Vec3::Zero();
  for (const Sample& sample : samples_) {
    const Mat3 R = R_camera_odom * sample.q_odom_camera.toRotationMatrix();
    scatter += R.col(0) * R.col(0).transpose();
    image_up -= R.col(1);
  }
  const double n = static_cast<double>(samples_.size());
  const Eigen::SelfAdjointEigenSolver<Mat3> solver(scatter / n);
  const Vec3& values = solver.eigenvalues();
  if (values(1) < kMinYawVariance || values(0) > kMaxRollVariance) {
    // Boxes are upright in the image, so its own vertical is the best axis for shapes.
    if (image_up.norm() > 1e-6) up.direction = image_up.normalized();
    return up;
  }
  up.direction = solver.eigenvectors().col(0);
  if (up.direction.dot(image_up) < 0.0) up.direction = -up.direction;
  up.certain = true;
  return up;
}

double UpEstimator::roll_rad(const Quaternion& q_odom_camera) const {
  constexpr double kMinInImage = 0.35;  // of up: the camera looks no nearer than 20 deg to the vertical
  const UpDirection up = estimate(q_odom_camera);
  if (!up.certain || up.direction.head<2>().norm() < kMinInImage) return 0.0;
  return std::atan2(-up.direction.x(), -up.direction.y());
}

}  // namespace semantic_topo_loop::core
