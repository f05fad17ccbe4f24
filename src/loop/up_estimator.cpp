#include "semantic_topo_loop/loop/up_estimator.h"

#include <Eigen/Eigenvalues>
#include <cmath>

namespace semantic_topo_loop::core {
namespace {

constexpr std::int64_t kSampleIntervalNs = 90'000'000;
/// Mean square of the x axes' vertical components: a roll of about 10 deg.
constexpr double kMaxRollVariance = 0.03;
/// Mean square along the second direction: the camera has turned by some 20 deg about the vertical.
constexpr double kMinYawVariance = 0.08;

}  // namespace

UpEstimator::UpEstimator(double span_s) : span_ns_(std::llround(1e9 * span_s)) {}

void UpEstimator::push(const Frame& frame) {
  if (frame.is_break) samples_.clear();
  if (!samples_.empty() && frame.stamp_ns - samples_.back().stamp_ns < kSampleIntervalNs) return;
  samples_.push_back({frame.stamp_ns, frame.T_odom_camera.q});
  while (frame.stamp_ns - samples_.front().stamp_ns > span_ns_) samples_.pop_front();
}

UpDirection UpEstimator::estimate(const Quaternion& q_odom_camera) const {
  UpDirection up;
  if (samples_.empty()) return up;
  const Mat3 R_camera_odom = q_odom_camera.conjugate().toRotationMatrix();
  Mat3 scatter = Mat3::Zero();
  Vec3 image_up = Vec3::Zero();
  for (const Sample& sample : samples_) {
    const Mat3 R = R_camera_odom * sample.q_odom_camera.toRotationMatrix();
    scatter += R.col(0) * R.col(0).transpose();
    image_up -= R.col(1);
  }
  const double n = static_cast<double>(samples_.size());
  const Eigen::SelfAdjointEigenSolver<Mat3> solver(scatter / n);
  const Vec3 values = solver.eigenvalues();
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

}  // namespace semantic_topo_loop::core
