#include "loop/graph/submap_refiner.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <utility>

#include "geometry/statistics.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

using Vec5 = Eigen::Matrix<double, 5, 1>;
using Mat5 = Eigen::Matrix<double, 5, 5>;
using Mat45 = Eigen::Matrix<double, 4, 5>;

/// Of the transform: its pose alone, or with the scale.
constexpr int kPose = 6, kPoseAndScale = 7;

constexpr int kMaxIterations = 15;
constexpr double kMinDecrease = 1e-6;  ///< of the cost, relative; less ends the iteration
constexpr double kMaxDamping = 1e6;
constexpr double kMinInformation = 1e-6;

/// One box of a matched object, on either side.
struct BoxMeasurement {
  Mat3 R_camera_local;
  Vec3 t_camera_local;
  Vec4 edges;
  Vec4 sqrt_information;
  std::size_t object;
  bool in_b;
};

/// The unknowns: T_a_b = T_0 * exp(delta), with a free scale its logarithm, and centre and log axes of each object in
/// a's frame.
template <int kUnknowns>
struct State {
  Eigen::Matrix<double, kUnknowns, 1> delta = Eigen::Matrix<double, kUnknowns, 1>::Zero();
  std::vector<Vec5> objects;
};

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
bool evaluate(const BoxMeasurement& m, const Side& side, const Vec3& axis_a, const Vec5& object,
              BoxResidual<kUnknowns>* result) {
  const Vec3 center_local = side.R_local_a * object.head<3>() + side.t_local_a;
  const Vec3 axis_local = side.R_local_a * axis_a;
  const Vec3 t_camera_local = side.scale * m.t_camera_local;
  const auto projection = project_spheroid(m.R_camera_local * center_local + t_camera_local,
                                           m.R_camera_local * axis_local, object.tail<2>());
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

/// Normal equations of the pose and the objects, which do not meet each other.
template <int kUnknowns>
struct NormalEquations {
  using MatP = Eigen::Matrix<double, kUnknowns, kUnknowns>;
  using VecP = Eigen::Matrix<double, kUnknowns, 1>;
  using MatP5 = Eigen::Matrix<double, kUnknowns, 5>;

  explicit NormalEquations(std::size_t objects)
      : H_pose_object(objects, MatP5::Zero()), H_object(objects, Mat5::Zero()), g_object(objects, Vec5::Zero()) {}

  MatP H_pose = MatP::Zero();
  VecP g_pose = VecP::Zero();
  std::vector<MatP5> H_pose_object;
  std::vector<Mat5> H_object;
  std::vector<Vec5> g_object;
  double cost = 0.0;

  void add(const BoxMeasurement& m, const BoxResidual<kUnknowns>& residual) {
    const double root = std::sqrt(1.0 + residual.r.squaredNorm());  // soft L1: 2 (sqrt(1 + |r|^2) - 1)
    const double weight = 1.0 / root;
    cost += 2.0 * (root - 1.0);
    H_object[m.object].noalias() += weight * residual.d_object.transpose() * residual.d_object;
    g_object[m.object].noalias() += weight * residual.d_object.transpose() * residual.r;
    if (!m.in_b) return;
    H_pose.noalias() += weight * residual.d_delta.transpose() * residual.d_delta;
    g_pose.noalias() += weight * residual.d_delta.transpose() * residual.r;
    H_pose_object[m.object].noalias() += weight * residual.d_delta.transpose() * residual.d_object;
  }

  /// Information of the pose once the objects are eliminated, and the step; `damping` scales the diagonals.
  MatP reduce(double damping, const State<kUnknowns>& state, State<kUnknowns>* next) const {
    MatP S = H_pose;
    S.diagonal() *= 1.0 + damping;
    VecP b = g_pose;
    std::vector<Eigen::LDLT<Mat5>> factors;
    for (std::size_t k = 0; k < H_object.size(); ++k) {
      Mat5 H = H_object[k];
      H.diagonal() *= 1.0 + damping;
      H.diagonal().array() += kMinInformation;
      factors.emplace_back(H);
      S -= H_pose_object[k] * factors.back().solve(H_pose_object[k].transpose());
      b -= H_pose_object[k] * factors.back().solve(g_object[k]);
    }
    if (next == nullptr) return S;
    const VecP step = -S.ldlt().solve(b);
    *next = state;
    next->delta += step;
    for (std::size_t k = 0; k < H_object.size(); ++k) {
      next->objects[k] -= factors[k].solve(g_object[k] + H_pose_object[k].transpose() * step);
    }
    return S;
  }
};

/// The up direction of both submaps in a's frame.
Vec3 common_axis(const LocalMap& a, const LocalMap& b, const SE3& T_a_b) {
  const Vec3 up_b = T_a_b.q * b.up.direction;
  if (a.up.certain != b.up.certain) return a.up.certain ? a.up.direction : up_b;
  const Vec3 sum = a.up.direction + up_b;
  return sum.norm() > 0.5 ? Vec3(sum.normalized()) : a.up.direction;
}

/// The whole problem: measurements with the index of their object, and the unknowns.
template <int kUnknowns>
class RefinementProblem {
 public:
  RefinementProblem(const LocalMap& a, const LocalMap& b, const SE3& T_0, const std::vector<NodePair>& pairs)
      : a_(a), b_(b), T_0_(T_0), axis_(common_axis(a, b, T_0)) {
    for (const NodePair& pair : pairs) {
      const Spheroid& s_a = a.objects[static_cast<std::size_t>(pair.a)].spheroid;
      const Spheroid& s_b = b.objects[static_cast<std::size_t>(pair.b)].spheroid;
      Vec5 object;
      object << 0.5 * (s_a.center + T_0 * s_b.center), 0.5 * (s_a.log_axes + s_b.log_axes);
      state_.objects.push_back(object);
    }
  }

  void add_views(int views, double sigma_px, double sigma_share, const std::vector<NodePair>& pairs) {
    for (std::size_t k = 0; k < pairs.size(); ++k) {
      add_object(a_, a_.objects[static_cast<std::size_t>(pairs[k].a)], false, k, views, sigma_px, sigma_share);
      add_object(b_, b_.objects[static_cast<std::size_t>(pairs[k].b)], true, k, views, sigma_px, sigma_share);
    }
  }

  /// Levenberg-Marquardt.   @return false if the start cannot be projected or the steps are not finite
  bool solve() {
    Equations equations(state_.objects.size()), next_equations(state_.objects.size());
    if (!linearise(state_, &equations, nullptr)) return false;
    double damping = 1e-4;
    for (int i = 0; i < kMaxIterations && damping < kMaxDamping; ++i) {
      State<kUnknowns> next;
      equations.reduce(damping, state_, &next);
      if (!next.delta.allFinite()) return false;
      const bool better = linearise(next, &next_equations, nullptr) && next_equations.cost < equations.cost;
      damping *= better ? 0.1 : 10.0;
      if (!better) continue;
      const bool settled = equations.cost - next_equations.cost < kMinDecrease * equations.cost;
      state_ = std::move(next);
      std::swap(equations, next_equations);
      if (settled) break;
    }
    return true;
  }

  SE3 T_a_b() const { return T_0_ * se3_exp(state_.delta.template head<6>()); }
  double scale() const { return side_b<kUnknowns>(T_0_, state_.delta).scale; }

  /// Marginal covariance of the pose by the Schur complement, and the median residual.
  /// @return false if the pose is not determined
  bool assess(double inflation, Refinement* refinement) const {
    Equations equations(state_.objects.size());
    std::vector<double> residuals;
    if (!linearise(state_, &equations, &residuals)) return false;
    const MatP H = equations.reduce(0.0, state_, nullptr);
    const Eigen::LDLT<MatP> ldlt(H);
    if (!H.allFinite() || !(ldlt.vectorD().minCoeff() > kMinInformation)) return false;
    // From a change of delta to a right perturbation of the result.
    const Side side = side_b<kUnknowns>(T_0_, state_.delta);
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
  using Equations = NormalEquations<kUnknowns>;
  using MatP = typename Equations::MatP;

  /// @return false if a box cannot see its object
  bool linearise(const State<kUnknowns>& state, Equations* equations, std::vector<double>* residuals) const {
    *equations = Equations(state.objects.size());
    const Side in_a, in_b = side_b<kUnknowns>(T_0_, state.delta);
    BoxResidual<kUnknowns> residual;
    for (const BoxMeasurement& m : measurements_) {
      if (!evaluate(m, m.in_b ? in_b : in_a, axis_, state.objects[m.object], &residual)) return false;
      equations->add(m, residual);
      for (int i = 0; residuals != nullptr && i < 4; ++i) residuals->push_back(std::abs(residual.r(i)));
    }
    return std::isfinite(equations->cost);
  }

  void add_object(const LocalMap& map, const LocalObject& object, bool in_b, std::size_t index, int views,
                  double sigma_px, double sigma_share) {
    const int n = static_cast<int>(object.views.size());
    const int count = std::min(n, views);
    for (int k = 0; k < count; ++k) {
      const SubmapView& view = object.views[static_cast<std::size_t>(k * n / count)];
      const LocalFrame& frame = map.frames[static_cast<std::size_t>(view.frame)];
      const Vec2 size_px = frame.focal_px.cwiseProduct(Vec2(view.box.width(), view.box.height()));
      const double sigma = sigma_px + sigma_share * std::sqrt(size_px.prod());
      const Vec4 sqrt_information =
          Vec4(frame.focal_px.x(), frame.focal_px.y(), frame.focal_px.x(), frame.focal_px.y()) / sigma;
      measurements_.push_back(
          {frame.R_camera_local, frame.t_camera_local, view.box.edges(), sqrt_information, index, in_b});
    }
  }

  const LocalMap& a_;
  const LocalMap& b_;
  SE3 T_0_;
  Vec3 axis_;
  State<kUnknowns> state_;
  std::vector<BoxMeasurement> measurements_;
};

}  // namespace

SubmapRefiner::SubmapRefiner(const LoopOptions& options)
    : free_scale_(options.scale == "free"),
      views_(options.refine_views),
      sigma_px_(options.refine_sigma_px),
      sigma_share_(options.refine_sigma_share),
      inflation_(options.covariance_inflation) {}

std::optional<Refinement> SubmapRefiner::refine(const LocalMap& a, const LocalMap& b, const SE3& T_a_b,
                                                const std::vector<NodePair>& pairs) const {
  if (pairs.size() < 3 || !T_a_b.is_finite()) return std::nullopt;
  return free_scale_ ? refine_with<kPoseAndScale>(a, b, T_a_b, pairs) : refine_with<kPose>(a, b, T_a_b, pairs);
}

template <int kUnknowns>
std::optional<Refinement> SubmapRefiner::refine_with(const LocalMap& a, const LocalMap& b, const SE3& T_a_b,
                                                     const std::vector<NodePair>& pairs) const {
  RefinementProblem<kUnknowns> problem(a, b, T_a_b, pairs);
  problem.add_views(views_, sigma_px_, sigma_share_, pairs);
  if (!problem.solve()) return std::nullopt;
  Refinement refinement;
  refinement.T_a_b = problem.T_a_b();
  refinement.scale = problem.scale();
  if (!problem.assess(inflation_, &refinement)) return std::nullopt;
  return refinement;
}

}  // namespace semantic_topo_loop::core
