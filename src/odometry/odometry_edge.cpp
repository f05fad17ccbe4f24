#include "odometry/odometry_edge.h"

#include "geometry/relative_pose.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kBreakTranslation_m = 30.0;
constexpr double kBreakRotation_rad = 3.0;

Mat6 diagonal(double translation_variance, double rotation_variance) {
  Vec6 variances;
  variances << Vec3::Constant(translation_variance), Vec3::Constant(rotation_variance);
  return variances.asDiagonal();
}

Mat6 floor_covariance() {
  return diagonal(kMinEdgeTranslation_m * kMinEdgeTranslation_m, kMinEdgeRotation_rad * kMinEdgeRotation_rad);
}

/// A jump by all or nothing, each as likely, as a normal distribution.
constexpr double kMeanJump = 0.5, kSigmaJump = 0.5;

/// At full suspicion.
Mat6 suspect_covariance(const OdometryEdge& edge) {
  return kSigmaJump * kSigmaJump * edge.suspect * edge.suspect.transpose() +
         diagonal(edge.suspect_error_m * edge.suspect_error_m, edge.suspect_error_rad * edge.suspect_error_rad);
}

}  // namespace

Vec6 expected_jump(const OdometryEdge& edge, const OdometryNoise& noise) {
  if (edge.is_break || edge.covariance) return Vec6::Zero();
  return kMeanJump * noise.suspicion * noise.suspicion * edge.suspect;
}

Mat6 odometry_covariance(const OdometryEdge& edge, const OdometryNoise& noise) {
  if (edge.is_break) {
    return diagonal(kBreakTranslation_m * kBreakTranslation_m, kBreakRotation_rad * kBreakRotation_rad);
  }
  if (edge.covariance) return *edge.covariance;
  return floor_covariance() +
         diagonal(noise.translation_m * noise.translation_m * edge.path_m,
                  noise.rotation_rad * noise.rotation_rad * edge.rotation_rad) +
         noise.suspicion * noise.suspicion * suspect_covariance(edge);
}

void OdometryAccumulator::add(const Frame& frame) {
  const bool is_first = !T_odom_previous_;
  const SE3 motion = is_first ? SE3() : T_odom_previous_->inverse() * frame.T_odom_camera;
  T_odom_previous_ = frame.T_odom_camera;
  if (is_first) return;
  if (frame.is_break) {
    edge_.is_break = true;
    return;
  }
  edge_.path_m += motion.t.norm();
  edge_.rotation_rad += rotation_angle(motion.q, Quaternion::Identity());
  all_stated_ = all_stated_ && frame.covariance && is_covariance(*frame.covariance);
  if (!all_stated_) return;
  const Mat6 carry = transport(motion);
  covariance_ = (carry * covariance_ * carry.transpose() + *frame.covariance).eval();
}

OdometryEdge OdometryAccumulator::finish(const SE3& T_odom_from, const SE3& T_odom_to) {
  OdometryEdge edge = edge_;
  edge.T_from_to = T_odom_from.inverse() * T_odom_to;
  if (all_stated_ && is_covariance(covariance_)) edge.covariance = covariance_;
  edge_ = OdometryEdge();
  all_stated_ = true;
  covariance_.setZero();
  return edge;
}

}  // namespace semantic_topo_loop::core
