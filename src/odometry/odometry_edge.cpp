#include "odometry/odometry_edge.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <tuple>

#include "geometry/relative_pose.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

/// Next to no knowledge: wider than any room, and all but half a turn.
constexpr double kBreakTranslation_m = 30.0, kBreakRotation_rad = 3.0;
/// What a standing camera's edge keeps, so that its information stays finite: well below what any odometry resolves.
constexpr double kMinEdgeTranslation_m = 2e-4, kMinEdgeRotation_rad = 1e-4;

/// Mean and sigma of a jump by all or nothing, each as likely, as shares of it.
constexpr double kMeanJump = 0.5, kSigmaJump = 0.5;

/// With a prior of 1.
Mat6 suspected_jump_covariance(const OdometryEdge& edge) {
  return kSigmaJump * kSigmaJump * edge.suspected_jump * edge.suspected_jump.transpose() +
         isotropic_covariance(edge.jump_error_m * edge.jump_error_m, edge.jump_error_rad * edge.jump_error_rad);
}

/// What the source does not vouch for.
Vec6 open_jump(const OdometryEdge& edge) { return edge.is_modelled() ? edge.suspected_jump : Vec6(Vec6::Zero()); }

std::size_t index(int vertex) { return static_cast<std::size_t>(vertex); }

constexpr OdometryNoise kOnlyJumps{0.0, 0.0, 0.0, 0.0, 0.0, 1.0};

bool is_motion(const SolvedMotion& motion) {
  const auto is_length = [](double value) { return std::isfinite(value) && value >= 0.0; };
  return motion.T_from_to.is_finite() && is_rotation(motion.T_from_to.q) && is_length(motion.path_m) &&
         is_length(motion.rotation_rad) && is_length(motion.missed.frozen_s) && is_length(motion.missed.slipped_s) &&
         (!motion.missed.is_any() || is_covariance(motion.missed.covariance));
}

EdgeCovariance by_causes(const OdometryEdge& edge) {
  if (edge.joined) return *edge.joined;
  EdgeCovariance parts;
  parts.given = odometry_covariance(edge, kNoNoise);
  parts.suspected_jumps = odometry_covariance(edge, kOnlyJumps) - parts.given;
  if (!edge.is_modelled()) return parts;
  parts.translation = isotropic_covariance(edge.path_m, 0.0);
  parts.rotation = isotropic_covariance(0.0, edge.rotation_rad);
  return parts;
}

OdometryEdge measured_edge(const OdometryEdge& edge) {
  if (!edge.measured) return edge;
  OdometryEdge measured = *edge.measured;
  measured.suspected_jump = edge.suspected_jump;
  measured.jump_error_m = edge.jump_error_m;
  measured.jump_error_rad = edge.jump_error_rad;
  return measured;
}

}  // namespace

EdgeCovariance& EdgeCovariance::operator+=(const EdgeCovariance& other) {
  given += other.given;
  translation += other.translation;
  rotation += other.rotation;
  suspected_jumps += other.suspected_jumps;
  return *this;
}

EdgeCovariance EdgeCovariance::carried(const Mat6& J) const {
  const auto carry = [&J](const Mat6& m) { return Mat6(J * m * J.transpose()); };
  return {carry(given), carry(translation), carry(rotation), carry(suspected_jumps)};
}

Mat6 isotropic_covariance(double translation_variance, double rotation_variance) {
  Vec6 variances;
  variances << Vec3::Constant(translation_variance), Vec3::Constant(rotation_variance);
  return variances.asDiagonal();
}

Vec6 expected_jump(const OdometryEdge& edge, const OdometryNoise& noise) {
  return kMeanJump * noise.jump_prior * noise.jump_prior * open_jump(edge);
}

Mat6 odometry_covariance(const OdometryEdge& edge, const OdometryNoise& noise) {
  if (edge.is_break) {
    return isotropic_covariance(kBreakTranslation_m * kBreakTranslation_m, kBreakRotation_rad * kBreakRotation_rad);
  }
  if (edge.covariance) return *edge.covariance;
  if (edge.joined) {
    return edge.joined->given + noise.translation_m * noise.translation_m * edge.joined->translation +
           noise.rotation_rad * noise.rotation_rad * edge.joined->rotation +
           noise.jump_prior * noise.jump_prior * edge.joined->suspected_jumps;
  }
  return isotropic_covariance(kMinEdgeTranslation_m * kMinEdgeTranslation_m,
                              kMinEdgeRotation_rad * kMinEdgeRotation_rad) +
         edge.missed.covariance +
         isotropic_covariance(noise.translation_m * noise.translation_m * edge.path_m,
                              noise.rotation_rad * noise.rotation_rad * edge.rotation_rad) +
         noise.jump_prior * noise.jump_prior * suspected_jump_covariance(edge);
}

Mat6 steady_covariance(const OdometryEdge& edge, const OdometryNoise& noise) {
  if (!edge.is_modelled()) return Mat6::Zero();
  // Chosen on fr3_office's drifted_real files; 4 m and more trust boxes too much there.
  constexpr double kSteadyFor_m = 1.0;
  const double way_m2 = kSteadyFor_m * edge.path_m;
  return isotropic_covariance(noise.steady_translation * noise.steady_translation * way_m2,
                              noise.steady_rotation_rad * noise.steady_rotation_rad * way_m2);
}

bool OdometryEdge::refine(const SolvedMotion& motion) {
  if (is_break || covariance || joined || !is_motion(motion)) return false;
  if (!measured) measured = std::make_shared<const OdometryEdge>(*this);
  T_from_to = motion.T_from_to;
  path_m = motion.path_m;
  rotation_rad = motion.rotation_rad;
  missed = motion.missed.is_any() ? motion.missed : MissedMotion();
  return true;
}

void OdometryEdge::settle(const SE3& T, const Mat6& error) {
  T_from_to = T;
  covariance = error;
  suspected_jump.setZero();
  jump_error_m = jump_error_rad = 0.0;
  joined.reset();
  measured.reset();
}

MissedMotion join(const MissedMotion& first, const MissedMotion& second, const SE3& T_from_to) {
  const Mat6 carry = transport(T_from_to);
  return {first.frozen_s + second.frozen_s, first.slipped_s + second.slipped_s,
          Mat6(carry * first.covariance * carry.transpose()) + second.covariance};
}

OdometryEdge join(const OdometryEdge& first, const OdometryEdge& second) {
  const Mat6 carry = transport(second.T_from_to);
  OdometryEdge edge;
  edge.T_from_to = first.T_from_to * second.T_from_to;
  edge.path_m = first.path_m + second.path_m;
  edge.rotation_rad = first.rotation_rad + second.rotation_rad;
  edge.is_break = first.is_break || second.is_break;
  edge.missed = join(first.missed, second.missed, second.T_from_to);
  edge.suspected_jump = carry * open_jump(first) + open_jump(second);
  if (first.measured || second.measured) {
    edge.measured = std::make_shared<const OdometryEdge>(join(measured_edge(first), measured_edge(second)));
  }
  if (first.covariance && second.covariance) {
    edge.covariance = Mat6(carry * *first.covariance * carry.transpose()) + *second.covariance;
    return edge;
  }
  EdgeCovariance sum = by_causes(second);
  sum += by_causes(first).carried(carry);
  edge.joined = std::make_shared<const EdgeCovariance>(sum);
  return edge;
}

std::vector<OdometryEdge> measured_edges(const std::vector<OdometryEdge>& edges) {
  if (std::none_of(edges.begin(), edges.end(), [](const OdometryEdge& edge) { return edge.measured != nullptr; }))
    return {};
  std::vector<OdometryEdge> measured;
  measured.reserve(edges.size());
  std::transform(edges.begin(), edges.end(), std::back_inserter(measured), measured_edge);
  return measured;
}

void WayCounter::add(const SE3& T_odom_camera) {
  // An odometry that stands jitters by millimetres; keyframes are apart by some of these. Chosen by that alone.
  constexpr double kStill_m = 0.01, kStill_rad = 0.0045;
  const double moved_m = (T_odom_camera.t - T_odom_counted_.t).norm();
  const double turned_rad = rotation_angle(T_odom_counted_.q, T_odom_camera.q);
  if (moved_m >= kStill_m) {
    path_m_ += moved_m;
    T_odom_counted_.t = T_odom_camera.t;
  }
  if (turned_rad >= kStill_rad) {
    rotation_rad_ += turned_rad;
    T_odom_counted_.q = T_odom_camera.q;
  }
}

void OdometryAccumulator::add(const Frame& frame) {
  const bool is_first = !T_odom_previous_;
  const SE3 motion = is_first ? SE3() : T_odom_previous_->inverse() * frame.T_odom_camera;
  T_odom_previous_ = frame.T_odom_camera;
  if (is_first || frame.is_break) way_.start(frame.T_odom_camera);
  if (is_first) return;
  if (frame.is_break) {
    edge_.is_break = true;
    return;
  }
  way_.add(frame.T_odom_camera);
  all_stated_ = all_stated_ && frame.covariance && is_covariance(*frame.covariance);
  if (!all_stated_) return;
  const Mat6 carry = transport(motion);
  covariance_ = (carry * covariance_ * carry.transpose() + *frame.covariance).eval();
}

OdometryEdge OdometryAccumulator::finish(const SE3& T_odom_from, const SE3& T_odom_to) {
  OdometryEdge edge = edge_;
  std::tie(edge.path_m, edge.rotation_rad) = way_.take();
  edge.T_from_to = T_odom_from.inverse() * T_odom_to;
  if (all_stated_ && is_covariance(covariance_)) edge.covariance = covariance_;
  edge_ = OdometryEdge();
  all_stated_ = true;
  covariance_.setZero();
  return edge;
}

PathNoise::PathNoise(const std::vector<SE3>& T_world_vertex, const std::vector<OdometryEdge>& edges)
    : vertices_(&T_world_vertex) {
  const std::size_t n = edges.size() + 1;
  sums_.assign(n, EdgeCovariance());
  residual_.assign(n, Vec6::Zero());
  jump_.assign(n, Vec6::Zero());
  stated_.assign(n, 0);
  for (std::size_t i = 0; i + 1 < n; ++i) {
    const OdometryEdge& edge = edges[i];
    SE3 place = about_first(T_world_vertex[i + 1]);
    // A break knows nothing, however far away; and beside the square of a far lever all else would be lost in rounding.
    if (edge.is_break) place.t.setZero();
    const Mat6 to_origin = transport(place.inverse());
    to_origin_.push_back(to_origin);
    EdgeCovariance parts = by_causes(edge);
    if (edge.is_break) parts.translation = parts.rotation = Mat6::Zero();
    sums_[i + 1] = sums_[i];
    sums_[i + 1] += parts.carried(to_origin);
    jump_[i + 1] = jump_[i] + to_origin * expected_jump(edge, kOnlyJumps);
    residual_[i + 1] = residual_[i];
    stated_[i + 1] = stated_[i] + (edge.covariance ? 1 : 0);
    if (!edge.is_break) {
      residual_[i + 1] += to_origin * relative_pose_residual(T_world_vertex[i], T_world_vertex[i + 1], edge.T_from_to);
    }
  }
}

SE3 PathNoise::about_first(const SE3& T_world_vertex) const {
  return {T_world_vertex.q, T_world_vertex.t - vertices_->front().t};
}

Innovation PathNoise::innovation(const GraphLoop& loop) const {
  const SE3 &T_world_from = (*vertices_)[index(loop.from)], &T_world_to = (*vertices_)[index(loop.to)];
  const Vec6 e = relative_pose_residual(T_world_from, T_world_to, loop.T_from_to);
  Mat6 by_motion = Mat6::Zero();
  by_motion.topLeftCorner<3, 3>() = so3_exp(e.tail<3>()).toRotationMatrix();
  by_motion.bottomRightCorner<3, 3>() = right_jacobian_inverse(e.tail<3>());
  Innovation innovation;
  innovation.from_origin = by_motion * transport(about_first(T_world_to));
  innovation.error = e - innovation.from_origin * (residual_[index(loop.to)] - residual_[index(loop.from)]);
  innovation.jump = innovation.from_origin * (jump_[index(loop.to)] - jump_[index(loop.from)]);
  return innovation;
}

double PathNoise::explaining_factor(const GraphLoop& loop, const OdometryNoise& noise, double max_factor) const {
  const Innovation innovation = this->innovation(loop);
  const auto along = [&](Mat6 EdgeCovariance::*cause) {
    const Mat6 difference = sums_[index(loop.to)].*cause - sums_[index(loop.from)].*cause;
    return Mat6(innovation.from_origin * difference * innovation.from_origin.transpose());
  };
  const Mat6 base = loop.covariance + along(&EdgeCovariance::given) +
                    noise.jump_prior * noise.jump_prior * along(&EdgeCovariance::suspected_jumps);
  const Mat6 noise_part = noise.translation_m * noise.translation_m * along(&EdgeCovariance::translation) +
                          noise.rotation_rad * noise.rotation_rad * along(&EdgeCovariance::rotation);
  // In the basis of V, V^T base V = 1 and V^T noise_part V is diagonal.
  const Eigen::GeneralizedSelfAdjointEigenSolver<Mat6> both(noise_part, base);
  if (both.info() != Eigen::Success) return std::numeric_limits<double>::infinity();
  const Vec6 y =
      both.eigenvectors().transpose() * (innovation.error - noise.jump_prior * noise.jump_prior * innovation.jump);
  const auto chi2 = [&](double factor) {
    return (y.array().square() / (1.0 + factor * factor * both.eigenvalues().array().max(0.0))).sum();
  };
  constexpr double kMedianChi2 = 5.348;  // of six degrees of freedom
  if (chi2(0.0) <= kMedianChi2) return 0.0;
  if (!(chi2(max_factor) <= kMedianChi2)) return std::numeric_limits<double>::infinity();
  double low = 0.0, high = max_factor;
  constexpr int kBisections = 30;  // to a billionth of max_factor
  for (int i = 0; i < kBisections; ++i) {
    const double middle = 0.5 * (low + high);
    (chi2(middle) <= kMedianChi2 ? high : low) = middle;
  }
  return high;
}

bool PathNoise::has_stated(const GraphLoop& loop) const { return stated_[index(loop.to)] != stated_[index(loop.from)]; }

}  // namespace semantic_topo_loop::core
