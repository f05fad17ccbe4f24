#include "loop/submap/submap_refiner.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <utility>

#include "geometry/least_squares.h"
#include "geometry/statistics.h"
#include "loop/submap/feature_alignment.h"
#include "loop/submap/spheroid.h"
#include "loop/submap/surface_alignment.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

using Mat45 = Eigen::Matrix<double, 4, 5>;

/// Of the transform: its pose alone, or with the scale.
constexpr int kPose = 6, kPoseAndScale = 7;
/// Of an object: centre and log axes; where depth is known, how much farther its centre is than the depths say, which
/// have taken it for thin. All views share that.
constexpr int kSpheroid = 5, kSpheroidAndOffset = 6;

/// The start is an alignment good to some centimetres; the limit keeps a bad one from costing an attempt its time.
constexpr LeastSquaresOptions kSolver{15, 1e-4, 1e-4};
/// Smallest pivot, 1/m^2 or 1/rad^2: with less the boxes leave a direction of the pose free (sigma above 1 km).
constexpr double kMinInformation = 1e-6;

/// Standard deviation of that offset: m, and a share of the lesser semi-axis.
constexpr double kOffset_m = 0.01, kOffsetShare = 0.3;

/// One box of a matched object, on either side.
struct BoxMeasurement {
  Mat3 R_camera_local;
  Vec3 t_camera_local;
  Vec4 edges;
  Vec4 sqrt_information;
  std::size_t object;
  bool in_b;
  double depth_m, depth_sigma_m;  ///< of the object's centre; 0 where the frame does not tell
};

/// The unknowns. Shared: delta of T_a_b = T_0 * exp(delta), with a free scale its logarithm; a block: an object in a's
/// frame.
template <int kUnknowns, int kBlock>
using State = ArrowUnknowns<kUnknowns, kBlock>;
template <int kUnknowns, int kBlock>
using Equations = ArrowEquations<kUnknowns, kBlock>;

/// Residual: (box edges of the projected spheroid - measured edges) / sigma.
template <int kUnknowns>
struct BoxResidual {
  Vec4 r;
  Eigen::Matrix<double, 4, kUnknowns> d_delta;
  Mat45 d_object;
};

/// What all boxes of a side share in one linearisation.
struct Side {
  Mat3 R_local_a = Mat3::Identity();
  Vec3 t_local_a = Vec3::Zero();
  Mat3 R_delta_inverse = Mat3::Identity();
  Mat3 J_right = Mat3::Identity();
  double scale = 1.0;  ///< of the side's unit of length
};

template <int kUnknowns>
Side side_b(const SE3& T_0, const Eigen::Matrix<double, kUnknowns, 1>& unknowns) {
  const Vec6 delta = unknowns.template head<6>();
  Side side;
  if constexpr (kUnknowns == kPoseAndScale) side.scale = std::exp(unknowns(6));
  side.R_delta_inverse = so3_exp(delta.tail<3>()).conjugate().toRotationMatrix();
  const Mat3 R_0_inverse = T_0.rotation().transpose();
  side.R_local_a = side.R_delta_inverse * R_0_inverse;
  side.t_local_a = -(side.R_delta_inverse * (R_0_inverse * T_0.t + delta.head<3>()));
  side.J_right = right_jacobian(delta.tail<3>());
  return side;
}

template <int kUnknowns>
bool evaluate(const BoxMeasurement& m, const Side& side, const Vec3& axis_a, const Vec3& center, const Vec2& log_axes,
              BoxResidual<kUnknowns>* result) {
  const Vec3 center_local = side.R_local_a * center + side.t_local_a;
  const Vec3 axis_local = side.R_local_a * axis_a;
  const Vec3 t_camera_local = side.scale * m.t_camera_local;
  const auto projection =
      project_spheroid(m.R_camera_local * center_local + t_camera_local, m.R_camera_local * axis_local, log_axes);
  if (!projection) return false;
  result->r = m.sqrt_information.cwiseProduct(projection->edges - m.edges);
  const Eigen::Matrix<double, 4, 3> d_center =
      m.sqrt_information.asDiagonal() * projection->d_center * m.R_camera_local;
  result->d_object.template leftCols<3>() = d_center * side.R_local_a;
  result->d_object.template rightCols<2>() = m.sqrt_information.asDiagonal() * projection->d_log_axes;
  if (!m.in_b) return true;
  const Eigen::Matrix<double, 4, 3> d_axis = m.sqrt_information.asDiagonal() * projection->d_axis * m.R_camera_local;
  result->d_delta.template leftCols<3>() = -d_center * side.R_delta_inverse;
  result->d_delta.template middleCols<3>(3) = (d_center * hat(center_local) + d_axis * hat(axis_local)) * side.J_right;
  if constexpr (kUnknowns == kPoseAndScale) {
    result->d_delta.col(6) = m.sqrt_information.asDiagonal() * projection->d_center * t_camera_local;
  }
  return true;
}

/// The up direction of both submaps in a's frame.
Vec3 common_axis(const LocalMap& a, const LocalMap& b, const SE3& T_a_b) {
  const Vec3 up_b = T_a_b.q * b.up.direction;
  if (a.up.certain != b.up.certain) return a.up.certain ? a.up.direction : up_b;
  const Vec3 sum = a.up.direction + up_b;
  return sum.norm() > 0.5 ? Vec3(sum.normalized()) : a.up.direction;
}

/// The whole problem: measurements with the index of their object, and the unknowns.
template <int kUnknowns, int kBlock>
class RefinementProblem {
 public:
  RefinementProblem(const LocalMap& a, const LocalMap& b, const SE3& T_0, const std::vector<NodePair>& pairs,
                    const LoopOptions& options)
      : T_0_(T_0), axis_(common_axis(a, b, T_0)) {
    for (const NodePair& pair : pairs) {
      const LocalObject& in_a = a.object(pair.a);
      const LocalObject& in_b = b.object(pair.b);
      const Spheroid &s_a = in_a.spheroid, &s_b = in_b.spheroid;
      add_object(a, in_a, false, options);
      add_object(b, in_b, true, options);
      typename Equations<kUnknowns, kBlock>::VecB object = Equations<kUnknowns, kBlock>::VecB::Zero();
      object.template head<3>() = 0.5 * (s_a.center + T_0 * s_b.center);
      object.template segment<2>(3) = 0.5 * (s_a.log_axes + s_b.log_axes);
      state_.blocks.push_back(object);
      offset_sigma_m_.push_back(kOffset_m + kOffsetShare * std::exp(object.template segment<2>(3).minCoeff()));
    }
  }

  /// @return false if the start cannot be projected or the steps are not finite
  bool solve() {
    Equations<kUnknowns, kBlock> equations(state_.blocks.size());
    const auto linearise = [this](const State<kUnknowns, kBlock>& state, Equations<kUnknowns, kBlock>* at) {
      return this->linearise(state, at, nullptr);
    };
    return minimise(kSolver, linearise, &state_, &equations);
  }

  SE3 T_a_b() const { return T_0_ * se3_exp(state_.shared.template head<6>()); }
  double scale() const { return side_b<kUnknowns>(T_0_, state_.shared).scale; }

  /// Marginal covariance of the pose by the Schur complement, and the median residual.
  /// @return false if the pose is not determined
  bool assess(double inflation, Refinement* refinement) const {
    Equations<kUnknowns, kBlock> equations(state_.blocks.size());
    std::vector<double> residuals;
    if (!linearise(state_, &equations, &residuals)) return false;
    const MatP H = equations.reduce(0.0, state_, nullptr);
    const Eigen::LDLT<MatP> ldlt(H);
    if (!H.allFinite() || !(ldlt.vectorD().minCoeff() > kMinInformation)) return false;
    // From a change of delta to a right perturbation of the result.
    const Side side = side_b<kUnknowns>(T_0_, state_.shared);
    MatP J = MatP::Identity();
    J.template topLeftCorner<3, 3>() = side.R_delta_inverse;
    J.template block<3, 3>(3, 3) = side.J_right;
    const MatP covariance = J * ldlt.solve(MatP::Identity()) * J.transpose();
    const MatP inflated = 0.5 * inflation * inflation * (covariance + covariance.transpose());
    refinement->covariance = inflated.template topLeftCorner<6, 6>();
    if constexpr (kUnknowns == kPoseAndScale) refinement->scale_covariance = inflated.col(6);
    refinement->median_residual = median(std::move(residuals));
    return inflated.allFinite();
  }

 private:
  using MatP = Eigen::Matrix<double, kUnknowns, kUnknowns>;

  static void add(const BoxMeasurement& m, const BoxResidual<kUnknowns>& residual,
                  Equations<kUnknowns, kBlock>* equations) {
    const double root = std::sqrt(1.0 + residual.r.squaredNorm());  // soft L1: 2 (sqrt(1 + |r|^2) - 1)
    const double weight = 1.0 / root;
    equations->cost += 2.0 * (root - 1.0);
    equations->H_block[m.object].template topLeftCorner<5, 5>().noalias() +=
        weight * residual.d_object.transpose() * residual.d_object;
    equations->g_block[m.object].template head<5>().noalias() += weight * residual.d_object.transpose() * residual.r;
    if (!m.in_b) return;
    equations->H_shared.noalias() += weight * residual.d_delta.transpose() * residual.d_delta;
    equations->g_shared.noalias() += weight * residual.d_delta.transpose() * residual.r;
    equations->H_shared_block[m.object].template leftCols<5>().noalias() +=
        weight * residual.d_delta.transpose() * residual.d_object;
  }

  /// Residual: (depth of the object's centre - offset - that which the frame tells) / sigma, soft L1.
  static void add_depth(const BoxMeasurement& m, const Side& side,
                        const typename Equations<kUnknowns, kBlock>::VecB& object,
                        Equations<kUnknowns, kBlock>* equations) {
    using Row3 = Eigen::RowVector3d;
    const Vec3 center_local = side.R_local_a * object.template head<3>() + side.t_local_a;
    const Row3 axis_local = m.R_camera_local.row(2) / m.depth_sigma_m;
    const double depth_m = side.scale * m.t_camera_local.z() - object(5) - m.depth_m;
    const double r = axis_local * center_local + depth_m / m.depth_sigma_m;
    const double root = std::sqrt(1.0 + r * r), weight = 1.0 / root;
    Eigen::Matrix<double, 1, kBlock> d_object = Eigen::Matrix<double, 1, kBlock>::Zero();
    d_object.template head<3>() = axis_local * side.R_local_a;
    d_object(5) = -1.0 / m.depth_sigma_m;
    equations->cost += 2.0 * (root - 1.0);
    equations->H_block[m.object] += weight * d_object.transpose() * d_object;
    equations->g_block[m.object] += weight * r * d_object.transpose();
    if (!m.in_b) return;
    Eigen::Matrix<double, 1, 6> d_delta;
    d_delta << -axis_local * side.R_delta_inverse, axis_local * hat(center_local) * side.J_right;
    equations->H_shared.template topLeftCorner<6, 6>() += weight * d_delta.transpose() * d_delta;
    equations->g_shared.template head<6>() += weight * r * d_delta.transpose();
    equations->H_shared_block[m.object].template topRows<6>() += weight * d_delta.transpose() * d_object;
  }

  /// A thing is flat, or as thick as its box is narrow: the offset is so large, or less.
  void add_offset_priors(const State<kUnknowns, kBlock>& state, Equations<kUnknowns, kBlock>* equations) const {
    for (std::size_t k = 0; k < state.blocks.size(); ++k) {
      const double offset = state.blocks[k](5), information = 1.0 / (offset_sigma_m_[k] * offset_sigma_m_[k]);
      equations->cost += information * offset * offset;
      equations->H_block[k](5, 5) += information;
      equations->g_block[k](5) += information * offset;
    }
  }

  /// @return false if a box cannot see its object
  bool linearise(const State<kUnknowns, kBlock>& state, Equations<kUnknowns, kBlock>* equations,
                 std::vector<double>* residuals) const {
    *equations = Equations<kUnknowns, kBlock>(state.blocks.size());
    const Side in_a, in_b = side_b<kUnknowns>(T_0_, state.shared);
    BoxResidual<kUnknowns> residual;
    for (const BoxMeasurement& m : measurements_) {
      const auto& object = state.blocks[m.object];
      const Side& side = m.in_b ? in_b : in_a;
      if (!evaluate(m, side, axis_, object.template head<3>(), object.template segment<2>(3), &residual)) return false;
      add(m, residual, equations);
      if constexpr (kBlock == kSpheroidAndOffset) {
        if (m.depth_m > 0.0) add_depth(m, side, object, equations);
      }
      for (int i = 0; residuals != nullptr && i < 4; ++i) {
        if (m.sqrt_information(i) > 0.0) residuals->push_back(std::abs(residual.r(i)));
      }
    }
    if constexpr (kBlock == kSpheroidAndOffset) add_offset_priors(state, equations);
    return std::isfinite(equations->cost);
  }

  /// The boxes of the object whose block comes next.
  void add_object(const LocalMap& map, const LocalObject& object, bool in_b, const LoopOptions& options) {
    for (const SubmapView& view : evenly_taken(object.views, static_cast<std::size_t>(options.refine_views))) {
      const LocalFrame& frame = map.frames[static_cast<std::size_t>(view.frame)];
      const Vec2 size_px = frame.focal_px.cwiseProduct(Vec2(view.box.width(), view.box.height()));
      const double sigma = options.refine_sigma_px + options.refine_sigma_share * std::sqrt(size_px.prod());
      Vec4 sqrt_information =
          Vec4(frame.focal_px.x(), frame.focal_px.y(), frame.focal_px.x(), frame.focal_px.y()) / sigma;
      leave_out_cut(view, &sqrt_information);
      measurements_.push_back({frame.R_camera_local, frame.t_camera_local, view.box.edges(), sqrt_information,
                               state_.blocks.size(), in_b, view.depth_m,
                               view.depth_m > 0.0 ? depth_sigma_m(view) : 0.0});
    }
  }

  SE3 T_0_;
  Vec3 axis_;
  State<kUnknowns, kBlock> state_;
  std::vector<BoxMeasurement> measurements_;
  std::vector<double> offset_sigma_m_;  ///< by object
};

template <int kUnknowns, int kBlock>
std::optional<Refinement> refine_with(const LocalMap& a, const LocalMap& b, const SE3& T_a_b,
                                      const std::vector<NodePair>& pairs, const LoopOptions& options) {
  RefinementProblem<kUnknowns, kBlock> problem(a, b, T_a_b, pairs, options);
  if (!problem.solve()) return std::nullopt;
  Refinement refinement;
  refinement.T_a_b = problem.T_a_b();
  refinement.scale = problem.scale();
  if (!problem.assess(options.covariance_inflation, &refinement)) return std::nullopt;
  return refinement;
}

}  // namespace

std::optional<Refinement> refine_submaps(const LocalMap& a, const LocalMap& b, const SE3& T_a_b,
                                         const std::vector<NodePair>& pairs, const LoopOptions& options) {
  if (pairs.size() < 3 || !T_a_b.is_finite()) return std::nullopt;
  if (options.scale == "free") return refine_with<kPoseAndScale, kSpheroid>(a, b, T_a_b, pairs, options);
  const auto has_depth = [](const LocalObject& object) {
    return std::any_of(object.views.begin(), object.views.end(),
                       [](const SubmapView& view) { return view.depth_m > 0.0; });
  };
  const bool with_depth = options.use_points && std::any_of(pairs.begin(), pairs.end(), [&](const NodePair& pair) {
                            return has_depth(a.object(pair.a)) || has_depth(b.object(pair.b));
                          });
  return with_depth ? refine_with<kPose, kSpheroidAndOffset>(a, b, T_a_b, pairs, options)
                    : refine_with<kPose, kSpheroid>(a, b, T_a_b, pairs, options);
}

LoopClosure make_closure(const LocalMap& match, const LocalMap& query) {
  LoopClosure loop;
  loop.query_keyframe_id = query.keyframe_id;
  loop.match_keyframe_id = match.keyframe_id;
  loop.query_frame = query.frame_id;
  loop.match_frame = match.frame_id;
  loop.query_stamp_ns = query.stamp_ns;
  loop.match_stamp_ns = match.stamp_ns;
  loop.query_begin = query.begin_frame;
  loop.query_end = query.end_frame;
  loop.match_begin = match.begin_frame;
  loop.match_end = match.end_frame;
  if (match.is_earlier) loop.T_earlier_match = match.T_odom_anchor;
  return loop;
}

namespace {

/// The objects of a submap, those at the indices `first` before the others.
std::vector<SubmapObject> list_objects(const LocalMap& map, const std::vector<int>& first) {
  std::vector<int> order = first;
  for (int i = 0; i < static_cast<int>(map.objects.size()); ++i) {
    if (std::find(first.begin(), first.end(), i) == first.end()) order.push_back(i);
  }
  std::vector<SubmapObject> objects;
  for (const int i : order) {
    const LocalObject& object = map.object(i);
    const double radius_m = std::exp(object.spheroid.log_axes(0));
    objects.push_back({object.landmark_id, object.class_id, object.spheroid.center, radius_m});
  }
  return objects;
}

}  // namespace

void set_alignment(const LocalMap& match, const LocalMap& query, const GraphMatch& alignment, LoopClosure* loop) {
  loop->rms_m = alignment.rms_m;
  loop->spread_m = alignment.spread_m(1);
  loop->inliers = static_cast<int>(alignment.pairs.size());
  loop->labels = alignment.classes;
  loop->T_match_query = alignment.T_a_b;
  loop->scale = alignment.scale;
  loop->matches.clear();
  std::vector<int> of_query, of_match;
  for (const NodePair& pair : alignment.pairs) {
    of_query.push_back(pair.b);
    of_match.push_back(pair.a);
    loop->matches.push_back({query.object(pair.b).landmark_id, match.object(pair.a).landmark_id});
  }
  loop->query_objects = list_objects(query, of_query);
  loop->match_objects = list_objects(match, of_match);
}

namespace {

/// What the surfaces of both submaps make of a loop.
enum class SurfaceVerdict { kSilent, kContradicts, kConfirms };

void take_pose(const SE3& T_match_query, const Mat6& covariance, LoopClosure* loop) {
  loop->T_match_query = T_match_query;
  loop->covariance = covariance;
  loop->state_sigmas(covariance);
}

/// Takes the pose that points of both submaps say, or else that of their surfaces, where they meet.
/// @return whether points say it
bool refine_on_depth(const LocalMap& match, const LocalMap& query, LoopClosure* loop) {
  if (match.features && query.features) {
    if (const auto aligned = align_features(match, query, loop->T_match_query)) {
      take_pose(aligned->T_a_b, aligned->covariance, loop);
      return true;
    }
  }
  if (match.surfels && query.surfels) {
    const auto aligned = align_surfaces(match, query, loop->T_match_query, loop->covariance);
    if (aligned) take_pose(aligned->T_a_b, aligned->covariance, loop);
  }
  return false;
}

SurfaceVerdict judge_surfaces(const LocalMap& match, const LocalMap& query, const SE3& T_match_query) {
  if (!match.surfels || !query.surfels) return SurfaceVerdict::kSilent;
  constexpr int kMinJudged = 200;            // surfels, 1 m^2: fewer may be what was moved
  constexpr double kMaxContradicted = 0.35;  // nine in ten right ones: below 0.22, wrong ones: above 0.47
  // To confirm: of fr1_xyz 188 right ones dissent by up to 0.013, in a rendered office 260 wrong ones from 0.16 on.
  constexpr int kMinSeen = 400;
  constexpr double kMaxDissent = 0.1;
  const SurfaceAgreement agreement = compare_surfaces(match, query, T_match_query);
  const auto is_below = [&agreement](double share) { return agreement.contradicted < share * agreement.judged; };
  if (agreement.judged >= kMinJudged && !is_below(kMaxContradicted)) return SurfaceVerdict::kContradicts;
  return agreement.judged >= kMinSeen && is_below(kMaxDissent) ? SurfaceVerdict::kConfirms : SurfaceVerdict::kSilent;
}

}  // namespace

void refine_and_decide(const LocalMap& match, const LocalMap& query, const GraphMatch& alignment,
                       bool needs_confirmation, const LoopOptions& options, LoopClosure* loop) {
  loop->reason = LoopReason::kRefinement;
  const std::optional<Refinement> refined = refine_submaps(match, query, alignment.T_a_b, alignment.pairs, options);
  if (!refined) return;
  loop->refine_residual = refined->median_residual;
  loop->refine_shift_m = (alignment.T_a_b.inverse() * refined->T_a_b).t.norm();
  loop->refine_shift_deg = degrees(rotation_angle(alignment.T_a_b.q, refined->T_a_b.q));
  loop->state_sigmas(refined->covariance);
  if (loop->refine_residual > options.refine_max_residual || loop->refine_shift_m > options.refine_max_shift_m ||
      loop->refine_shift_deg > options.refine_max_shift_deg) {
    return;
  }
  loop->T_match_query = refined->T_a_b;
  loop->covariance = refined->covariance;
  loop->scale *= refined->scale;
  loop->scale_covariance = refined->scale_covariance;
  const bool points_agree = refine_on_depth(match, query, loop);
  const SurfaceVerdict verdict = judge_surfaces(match, query, loop->T_match_query);
  if (verdict == SurfaceVerdict::kContradicts) {
    loop->reason = LoopReason::kContradicted;
    return;
  }
  if (needs_confirmation && !points_agree && verdict != SurfaceVerdict::kConfirms) {
    loop->reason = LoopReason::kTooFewInliers;
    return;
  }
  if (loop->sigma_m > options.max_sigma_m || loop->sigma_deg > options.max_sigma_deg) return;
  loop->reason = LoopReason::kAccepted;
  loop->accepted = true;
}

void decide_by_points(const LocalMap& match, const LocalMap& query, LoopClosure* loop) {
  if (!match.features || !query.features) return;
  const std::optional<FeatureAlignment> aligned = align_features(match, query, std::nullopt);
  if (!aligned) return;
  take_pose(aligned->T_a_b, aligned->covariance, loop);
  loop->inliers = aligned->points;
  loop->accepted = judge_surfaces(match, query, aligned->T_a_b) != SurfaceVerdict::kContradicts;
  loop->reason = loop->accepted ? LoopReason::kFoundBySource : LoopReason::kContradicted;
}

}  // namespace semantic_topo_loop::core
