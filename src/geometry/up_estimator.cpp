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
constexpr double kMinInImage = 0.35;  ///< of up: the camera looks no nearer than 20 deg to the vertical

constexpr std::size_t kPlanePoints = 500;  // of a frame: enough for its largest surface
constexpr int kHypotheses = 60;  // finds a plane of half of the points in 99.9 % of the frames, of a third in 90 %
constexpr double kMinPlaneShare = 0.2;  // of the points: a desk between a wall and what stands on it
constexpr double kMinUpward = 0.5;      // of up along image-up: the camera is tilted, or rolled, by up to 60 deg
constexpr double kMinUpright = 0.5;     // of the samples
constexpr double kAgreeing = 0.985;     // cosine: normals within 10 deg agree
constexpr double kOther = 0.94;         // cosine: those 20 deg apart are of surfaces that cannot both be level
constexpr double kClear = 2.0;          // as many frames as for any other direction
constexpr std::size_t kMinVotes = 5;    // half a second of frames
constexpr std::size_t kCandidates = 100;

/// The normals, towards the camera, of the two largest surfaces of a frame; camera frame.
std::vector<Vec3> surfaces(const std::vector<Vec3>& points_camera) {
  std::vector<Vec3> points;
  points.reserve(kPlanePoints + 1);
  std::size_t step = points_camera.size() / kPlanePoints + 1;
  if (step > 1) step |= 1;  // not in step with the lines of an even grid
  for (std::size_t i = 0; i < points_camera.size(); i += step) {
    if (points_camera[i].allFinite() && points_camera[i].z() > 0.0) points.push_back(points_camera[i]);
  }
  constexpr int kSurfaces = 2;  // the largest may be a wall
  std::vector<Vec3> normals;
  for (int i = 0; i < kSurfaces; ++i) {
    const std::optional<Plane> plane = dominant_plane(points, kHypotheses, kMinPlaneShare);
    if (!plane) break;
    normals.push_back(plane->normal);
    const auto lies_in = [&plane](const Vec3& p) { return plane->holds(p); };
    points.erase(std::remove_if(points.begin(), points.end(), lies_in), points.end());
  }
  return normals;
}

}  // namespace

UpEstimator::UpEstimator(double span_s) : span_ns_(std::llround(1e9 * span_s)) {}

void UpEstimator::push(const Frame& frame) {
  if (frame.is_break) clear();
  if (!samples_.empty() && frame.stamp_ns - samples_.back().stamp_ns < kSampleInterval_ns) return;
  samples_.push_back({frame.stamp_ns, frame.T_odom_camera.q, {}});
  while (frame.stamp_ns - samples_.front().stamp_ns > span_ns_) samples_.pop_front();
  if (frame.points_camera) {
    samples_.back().normals_odom = surfaces(*frame.points_camera);
    for (Vec3& normal : samples_.back().normals_odom) normal = frame.T_odom_camera.q * normal;
  }
  const std::optional<Vec3> normal = level_normal();
  is_clear_ = normal.has_value();
  if (is_clear_) level_normal_odom_ = normal;
}

void UpEstimator::clear() {
  samples_.clear();
  level_normal_odom_.reset();
  is_clear_ = false;
}

double UpEstimator::upright_share(const Vec3& up_odom) const {
  const auto is_upright = [&up_odom](const Sample& sample) {
    return (sample.q_odom_camera * -Vec3::UnitY()).dot(up_odom) > kMinUpward;
  };
  return static_cast<double>(std::count_if(samples_.begin(), samples_.end(), is_upright)) /
         static_cast<double>(samples_.size());
}

/// The direction of most surfaces, those counting most towards which image-up is most often.
std::optional<Vec3> UpEstimator::level_normal() const {
  std::vector<Vec3> normals;
  for (const Sample& sample : samples_) {
    normals.insert(normals.end(), sample.normals_odom.begin(), sample.normals_odom.end());
  }
  if (normals.size() < kMinVotes) return std::nullopt;
  struct Candidate {
    Vec3 direction;
    double score;
  };
  std::vector<Candidate> candidates;
  for (std::size_t i = 0; i < normals.size(); i += normals.size() / kCandidates + 1) {
    Vec3 sum = Vec3::Zero();
    std::size_t count = 0;
    for (const Vec3& other : normals) {
      if (normals[i].dot(other) < kAgreeing) continue;
      sum += other;
      ++count;
    }
    if (count < kMinVotes) continue;
    const Vec3 direction = sum.normalized();
    const double share = upright_share(direction);
    if (share >= kMinUpright) candidates.push_back({direction, share * static_cast<double>(count)});
  }
  const auto best = std::max_element(candidates.begin(), candidates.end(),
                                     [](const Candidate& a, const Candidate& b) { return a.score < b.score; });
  const auto rivals = [&best](const Candidate& other) {
    return other.direction.dot(best->direction) < kOther && kClear * other.score > best->score;
  };
  if (best == candidates.end() || std::any_of(candidates.begin(), candidates.end(), rivals)) return std::nullopt;
  return best->direction;
}

UpDirection UpEstimator::estimate(const Quaternion& q_odom_camera) const {
  UpDirection up;
  if (samples_.empty()) return up;
  const Mat3 R_camera_odom = q_odom_camera.conjugate().toRotationMatrix();
  if (is_clear_) return {R_camera_odom * *level_normal_odom_, true};
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
  Vec3 vertical = solver.eigenvectors().col(0);
  if (vertical.dot(image_up) < 0.0) vertical = -vertical;
  const bool is_vertical = values(1) >= kMinYawVariance && values(0) <= kMaxRollVariance;
  // The x axes of a camera that only rolls are perpendicular to where it looks.
  if (is_vertical && vertical.dot(image_up) >= kMinInImage * n) return {vertical, true};
  if (level_normal_odom_) return {R_camera_odom * *level_normal_odom_, true};
  // Boxes are upright in the image, so its own vertical is the best axis for shapes.
  if (image_up.norm() > 1e-6) up.direction = image_up.normalized();
  return up;
}

double UpEstimator::roll_rad(const Quaternion& q_odom_camera) const {
  const UpDirection up = estimate(q_odom_camera);
  if (!up.certain || up.direction.head<2>().norm() < kMinInImage) return 0.0;
  return std::atan2(-up.direction.x(), -up.direction.y());
}

}  // namespace semantic_topo_loop::core
