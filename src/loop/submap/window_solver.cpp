#include "loop/submap/window_solver.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <utility>
#include <vector>

#include "geometry/least_squares.h"
#include "geometry/relative_pose.h"
#include "geometry/statistics.h"
#include "loop/submap/bridging.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

using Mat5 = Eigen::Matrix<double, 5, 5>;

// Chosen on the shared drifted_real files of fr2_desk and fr3_office, judged on those in drifted, which are made
// differently.
constexpr double kBoxWeight = 0.5;  ///< what is left of a box's by errors that neighbours share
constexpr double kBoxDoubt = 2.0;   ///< sigmas, from which on boxes count less (Cauchy)
/// Sigmas of where an object starts from (m) and of the logarithm of its extent.
constexpr double kStartSigma = 1.0;

/// What goes on for longer is no slip but how the odometry is, which its noise is to tell; it is over when none has
/// been found for so long.
constexpr std::int64_t kLongestSlip_ns = 5'000'000'000, kSlipOver_ns = 1'500'000'000;
constexpr double kLearnInterval_s = 0.6;  ///< windows closer in time say the same
constexpr double kBoxRate = 0.1;          ///< by which the boxes' errors are learnt, a window
constexpr std::size_t kMinSides = 80;     ///< of boxes, for that
constexpr double kMaxBoxFactor = 5.0;     ///< either way: boxes of a simulation may be exact

double squared(double x) { return x * x; }

struct Unknowns {
  std::vector<SE3> T_odom_knot;
  std::vector<Vec6> drifts;  ///< (translation m/s, rotation rad/s), camera frame
  std::vector<Vec5> objects;

  bool is_finite() const {
    return std::all_of(T_odom_knot.begin(), T_odom_knot.end(), [](const SE3& T) { return T.is_finite(); });
  }
};

/// What is eliminated from the normal equations, an object or a drift: it meets knots alone.
template <int kSize>
struct EliminatedBlock {
  using Vec = Eigen::Matrix<double, kSize, 1>;
  using Mat = Eigen::Matrix<double, kSize, kSize>;
  using KnotMat = Eigen::Matrix<double, 6, kSize>;

  Mat H;
  Vec g;
  std::vector<std::pair<Eigen::Index, KnotMat>> H_knot;  ///< by the knot's row, ascending

  void reset(double information) {
    H = Mat::Identity() * information;
    g.setZero();
    H_knot.clear();  // its memory stays
  }
  /// @return the inverse of H, damped   @param S, b of the knots, from which its share is taken off
  Mat eliminate(double damping, Eigen::MatrixXd* S, Eigen::VectorXd* b) const {
    Mat damped = H;
    damped.diagonal() *= 1.0 + damping;
    const Mat inverse = damped.inverse();
    for (std::size_t i = 0; i < H_knot.size(); ++i) {
      const auto& [row, by_row] = H_knot[i];
      const KnotMat W = by_row * inverse;
      b->template segment<6>(row) -= W * g;
      for (std::size_t j = 0; j <= i; ++j) {
        const auto& [column, by_column] = H_knot[j];
        S->template block<6, 6>(row, column).noalias() -= W * by_column.transpose();
      }
    }
    return inverse;
  }
  /// @param step of the knots   @return its own
  Vec step(const Mat& inverse, const Eigen::VectorXd& step) const {
    Vec gradient = g;
    for (const auto& [row, by_row] : H_knot) gradient += by_row.transpose() * step.template segment<6>(row);
    return -inverse * gradient;
  }
};

/// Normal equations of the knots, with objects and drifts apart: H step = -g, the lower triangle of H.
struct Equations {
  using Unknowns = core::Unknowns;

  Eigen::MatrixXd H;
  Eigen::VectorXd g;
  std::vector<EliminatedBlock<5>> objects;
  std::vector<EliminatedBlock<6>> drifts;
  double cost = 0.0;
  Eigen::MatrixXd S;  ///< of reduce()

  void reset(const WindowProblem& problem, const Unknowns& unknowns) {
    const auto n = static_cast<Eigen::Index>(6 * unknowns.T_odom_knot.size());
    H.setZero(n, n);
    S.resize(n, n);
    g.setZero(n);
    drifts.resize(unknowns.drifts.size());
    for (EliminatedBlock<6>& drift : drifts) drift.reset(0.0);
    objects.resize(unknowns.objects.size());
    cost = 0.0;
    for (std::size_t k = 0; k < objects.size(); ++k) {
      const Vec5 moved = unknowns.objects[k] - problem.tracks[k].start;
      objects[k].reset(1.0 / squared(kStartSigma));
      objects[k].g = moved / squared(kStartSigma);
      cost += moved.squaredNorm() / squared(kStartSigma);
    }
  }

  /// Eliminates objects and drifts (Schur complement).
  /// @return information of the knots, its lower triangle; its root, if the step was asked for. Here, not a copy
  Eigen::MatrixXd& reduce(double damping, const Unknowns& unknowns, Unknowns* next) {
    S.triangularView<Eigen::Lower>() = H;
    S.diagonal() *= 1.0 + damping;
    Eigen::VectorXd b = g;
    std::vector<Mat5> of_objects;
    std::vector<Mat6> of_drifts;
    for (const auto& object : objects) of_objects.push_back(object.eliminate(damping, &S, &b));
    for (const auto& drift : drifts) of_drifts.push_back(drift.eliminate(damping, &S, &b));
    if (next == nullptr) return S;
    const Eigen::VectorXd step = -Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>>(S).solve(b);  // in the place of S
    *next = unknowns;
    Eigen::Index row = 0;
    for (SE3& pose : next->T_odom_knot) {
      pose.t += step.segment<3>(row);
      pose.q = (so3_exp(step.segment<3>(row + 3)) * pose.q).normalized();
      row += 6;
    }
    for (std::size_t k = 0; k < drifts.size(); ++k) next->drifts[k] += drifts[k].step(of_drifts[k], step);
    for (std::size_t k = 0; k < objects.size(); ++k) next->objects[k] += objects[k].step(of_objects[k], step);
    return S;
  }
};

/// Errors of a step, the drift taken off, and its derivatives.
RelativePoseTerms step_terms(const WindowProblem& problem, const Unknowns& unknowns, std::size_t step) {
  RelativePoseTerms terms =
      relative_pose_terms(unknowns.T_odom_knot[step], unknowns.T_odom_knot[step + 1], problem.odometry(step));
  terms.residual -= problem.duration_s(step) * unknowns.drifts[static_cast<std::size_t>(problem.drift_of[step])];
  return terms;
}

void add_odometry(const WindowProblem& problem, const Unknowns& unknowns, Equations* equations) {
  Eigen::MatrixXd& H = equations->H;
  for (std::size_t i = 0; i < problem.steps(); ++i) {
    const double dt = problem.duration_s(i);
    const RelativePoseTerms terms = step_terms(problem, unknowns, i);
    const Vec6 weights = problem.step_variances(i).cwiseInverse();
    equations->cost += terms.residual.dot(weights.asDiagonal() * terms.residual);
    const Mat6 from = terms.J_from.transpose() * weights.asDiagonal();
    const Mat6 to = terms.J_to.transpose() * weights.asDiagonal();
    const auto a = static_cast<Eigen::Index>(6 * i), b = a + 6;
    H.block<6, 6>(a, a) += from * terms.J_from;
    H.block<6, 6>(b, a) += to * terms.J_from;
    H.block<6, 6>(b, b) += to * terms.J_to;
    equations->g.segment<6>(a) += from * terms.residual;
    equations->g.segment<6>(b) += to * terms.residual;
    EliminatedBlock<6>& drift = equations->drifts[problem.drift_of[i]];
    if (drift.H_knot.empty()) drift.H_knot.emplace_back(a, Mat6::Zero());
    drift.H_knot.back().second -= dt * from;
    drift.H_knot.emplace_back(b, -dt * to);
    drift.H.diagonal() += dt * dt * weights;
    drift.g -= dt * weights.cwiseProduct(terms.residual);
  }
  const Vec6 weights = problem.drift_variances().cwiseInverse();
  for (std::size_t k = 0; k < unknowns.drifts.size(); ++k) {
    const Vec6 weighted = weights.cwiseProduct(unknowns.drifts[k]);
    equations->cost += unknowns.drifts[k].dot(weighted);
    equations->drifts[k].H.diagonal() += weights;
    equations->drifts[k].g += weighted;
  }
  constexpr double kFixed = 1e10;  // 1/m^2 and 1/rad^2: the anchor stays
  H.diagonal().segment<6>(static_cast<Eigen::Index>(6 * problem.anchor)).array() += kFixed;
}

/// Of the sum over four sides, two of which make a place: what Cauchy's loss makes of it.
double box_loss(double squares) { return 2.0 * squared(kBoxDoubt) * std::log1p(0.5 * squares / squared(kBoxDoubt)); }

void add_view(const WindowView& view, const SE3& T_odom_camera, std::size_t k, const SizedPoint& object,
              Equations* equations) {
  const std::optional<SizedProjection> projection = project(view, T_odom_camera, object);
  if (!projection) {
    equations->cost += kBoxWeight * box_loss(kUnseenChi2);
    return;
  }
  const Vec4& r = projection->residual;
  equations->cost += kBoxWeight * box_loss(r.squaredNorm());
  const double weight = kBoxWeight / (1.0 + 0.5 * r.squaredNorm() / squared(kBoxDoubt));
  const Vec3& p = projection->in_camera;
  const Vec2& half = object.half;
  const double z = p.z();
  Eigen::Matrix<double, 4, 3> by_point;
  by_point << 1.0, 0.0, -(p.x() - half.x()) / z, 0.0, 1.0, -(p.y() - half.y()) / z, 1.0, 0.0, -(p.x() + half.x()) / z,
      0.0, 1.0, -(p.y() + half.y()) / z;
  Eigen::Matrix<double, 4, 5> J_object;
  J_object.leftCols<3>() = by_point * T_odom_camera.rotation().transpose();
  J_object.rightCols<2>() << -half.x(), 0.0, 0.0, -half.y(), half.x(), 0.0, 0.0, half.y();
  J_object /= z * view.sigma;
  for (int side = 0; side < 4; ++side) {
    if (!view.bounds(side)) J_object.row(side).setZero();
  }
  Eigen::Matrix<double, 4, 6> J_knot;
  J_knot << -J_object.leftCols<3>(), J_object.leftCols<3>() * hat(object.center - T_odom_camera.t);
  const auto row = static_cast<Eigen::Index>(6 * view.knot);
  const Eigen::Matrix<double, 6, 4> weighted_knot = weight * J_knot.transpose();
  const Eigen::Matrix<double, 5, 4> weighted_object = weight * J_object.transpose();
  equations->H.block<6, 6>(row, row).noalias() += weighted_knot * J_knot;
  equations->g.segment<6>(row).noalias() += weighted_knot * r;
  EliminatedBlock<5>& eliminated = equations->objects[k];
  eliminated.H.noalias() += weighted_object * J_object;
  eliminated.g.noalias() += weighted_object * r;
  eliminated.H_knot.emplace_back(row, weighted_knot * J_object);
}

/// The most likely drifts for the knots as they are.
void start_drifts(const WindowProblem& problem, Unknowns* unknowns) {
  unknowns->drifts.assign(problem.drifts(), Vec6::Zero());
  std::vector<Vec6> sums = unknowns->drifts, weights(sums.size(), problem.drift_variances().cwiseInverse());
  for (std::size_t i = 0; i < problem.steps(); ++i) {
    const Vec6 weighted = problem.duration_s(i) * problem.step_variances(i).cwiseInverse();
    const std::size_t drift = problem.drift_of[i];
    sums[drift] += weighted.cwiseProduct(step_terms(problem, *unknowns, i).residual);
    weights[drift] += problem.duration_s(i) * weighted;
  }
  for (std::size_t k = 0; k < sums.size(); ++k) unknowns->drifts[k] = sums[k].cwiseQuotient(weights[k]);
}

bool solve(const WindowProblem& problem, Unknowns* unknowns, Equations* equations, Equations* spare) {
  unknowns->T_odom_knot = problem.start;
  start_drifts(problem, unknowns);
  for (const WindowTrack& track : problem.tracks) unknowns->objects.push_back(track.start);
  const auto linearise = [&problem](const Unknowns& at, Equations* normal) {
    normal->reset(problem, at);
    add_odometry(problem, at, normal);
    for (std::size_t k = 0; k < problem.tracks.size(); ++k) {
      const SizedPoint object(at.objects[k]);
      for (const WindowView& view : problem.tracks[k].views) {
        add_view(view, at.T_odom_knot[view.knot], k, object, normal);
      }
    }
    return std::isfinite(normal->cost);
  };
  LeastSquaresOptions options;
  const auto is_missed = [](double seconds) { return seconds > 0.0; };
  const bool starts_far = std::any_of(problem.missed_s.begin(), problem.missed_s.end(), is_missed);
  options.max_iterations = starts_far ? 12 : 4;
  options.min_decrease = 4e-2;  // of a window that is solved again, a little later
  return minimise(options, linearise, unknowns, equations, spare);
}

/// Median squared residual of a side over that of a normal distribution; nullopt where there are few.
std::optional<double> box_variance(const WindowProblem& problem, const Unknowns& unknowns) {
  std::vector<double> squares;
  for (std::size_t k = 0; k < problem.tracks.size(); ++k) {
    const SizedPoint object(unknowns.objects[k]);
    for (const WindowView& view : problem.tracks[k].views) {
      const auto projection = project(view, unknowns.T_odom_knot[view.knot], object);
      for (int side = 0; side < 4 && projection; ++side) {
        if (view.bounds(side)) squares.push_back(squared(projection->residual(side)));
      }
    }
  }
  constexpr double kMedianChi2 = 0.455;
  if (squares.size() < kMinSides) return std::nullopt;
  return median(std::move(squares)) / kMedianChi2;
}

/// R of R^T R = information^-1, lower triangular: of it and of L no more is computed than is not zero.
/// @param information its lower triangle, in blocks of 6; overwritten
Eigen::MatrixXd covariance_root(Eigen::MatrixXd* information) {
  const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> llt(*information);
  const auto n = information->rows();
  Eigen::MatrixXd root = Eigen::MatrixXd::Identity(n, n);
  for (Eigen::Index begin = 0; begin < n; begin += 6) {
    auto column = root.block(begin, begin, n - begin, 6);
    llt.matrixLLT().bottomRightCorner(n - begin, n - begin).triangularView<Eigen::Lower>().solveInPlace(column);
  }
  return root;
}

/// How well knots and drifts are known at a solution.
struct Knowledge {
  Eigen::MatrixXd root;                   ///< of the knots, see covariance_root
  std::vector<Mat6> drifts;               ///< covariances of the drifts, were the knots known
  std::vector<Eigen::MatrixXd> by_drift;  ///< the root times how each drift follows the knots, but for the sign

  explicit Knowledge(Equations* equations) : root(covariance_root(&equations->reduce(0.0, {}, nullptr))) {
    for (const EliminatedBlock<6>& drift : equations->drifts) {
      drifts.push_back(drift.H.inverse());
      by_drift.push_back(Eigen::MatrixXd::Zero(root.rows(), 6));
      for (const auto& [row, by_row] : drift.H_knot) {
        by_drift.back().bottomRows(root.rows() - row) += of_knot(row, row) * (by_row * drifts.back());
      }
    }
  }
  /// Its columns of the root, from a row on above which they are zero, or farther up.
  Eigen::Block<const Eigen::MatrixXd, Eigen::Dynamic, 6> of_knot(Eigen::Index knot_row, Eigen::Index from_row) const {
    return root.block<Eigen::Dynamic, 6>(from_row, knot_row, root.rows() - from_row, 6);
  }
  /// Of the motion of a step, behind it.
  Mat6 step_covariance(std::size_t step, const RelativePoseTerms& terms) const {
    const auto row = static_cast<Eigen::Index>(6 * step);
    const Eigen::Matrix<double, Eigen::Dynamic, 6> left =
        of_knot(row, row) * terms.J_from.transpose() + of_knot(row + 6, row) * terms.J_to.transpose();
    return left.transpose() * left;
  }
  Vec6 knot_variances(Eigen::Index row) const { return of_knot(row, row).colwise().squaredNorm(); }
  Vec6 drift_variances(std::size_t drift) const {
    return drifts[drift].diagonal() + Vec6(by_drift[drift].colwise().squaredNorm());
  }
  /// Of the errors of a step.
  Vec6 step_variances(std::size_t step, double duration_s, std::size_t drift, const RelativePoseTerms& terms) const {
    const auto row = static_cast<Eigen::Index>(6 * step);
    Eigen::Matrix<double, Eigen::Dynamic, 6> left = duration_s * by_drift[drift];
    left.bottomRows(root.rows() - row) +=
        of_knot(row, row) * terms.J_from.transpose() + of_knot(row + 6, row) * terms.J_to.transpose();
    return Vec6(left.colwise().squaredNorm()) + squared(duration_s) * drifts[drift].diagonal();
  }
};

/// How late the odometry's poses are, seen as an unknown of the problem at its solution: by a delay the odometry of a
/// step is off by what the velocities at its ends differ, and one step of Gauss and Newton finds it.
/// @param excess on the odometry's variances   @param delay_s taken out before   @param elapsed_s since a window told
void learn_delay(const WindowProblem& problem, const Unknowns& unknowns, const Knowledge& knowledge, double excess,
                 double delay_s, double elapsed_s, OdometryDelay* delay) {
  Eigen::VectorXd by_knots = Eigen::VectorXd::Zero(knowledge.root.rows());
  std::vector<Vec6> by_drifts(unknowns.drifts.size(), Vec6::Zero());
  double gradient = 0.0, information = 0.0;
  for (std::size_t i = 0; i < problem.steps(); ++i) {
    const std::optional<Vec6>&from = problem.velocities[i], &to = problem.velocities[i + 1];
    if (problem.is_missed(i) || !from || !to) continue;
    const RelativePoseTerms terms = step_terms(problem, unknowns, i);
    const Vec6 by_delay = transport(problem.odometry(i)) * *from - *to;
    const Vec6 weighted = by_delay.cwiseQuotient(problem.step_variances(i));
    gradient += weighted.dot(terms.residual);
    information += weighted.dot(by_delay);
    const auto row = static_cast<Eigen::Index>(6 * i);
    by_knots.segment<6>(row) += terms.J_from.transpose() * weighted;
    by_knots.segment<6>(row + 6) += terms.J_to.transpose() * weighted;
    by_drifts[problem.drift_of[i]] -= problem.duration_s(i) * weighted;
  }
  Eigen::VectorXd left = knowledge.root.triangularView<Eigen::Lower>() * by_knots;
  for (std::size_t k = 0; k < by_drifts.size(); ++k) {
    left -= knowledge.by_drift[k] * by_drifts[k];
    information -= by_drifts[k].dot(knowledge.drifts[k] * by_drifts[k]);
  }
  information -= left.squaredNorm();
  // Windows overlap: what a part of the time tells counts once.
  const double new_share = std::min(1.0, elapsed_s / (problem.times_s.back() - problem.times_s.front()));
  delay->add(delay_s - gradient / information, new_share * information / excess, elapsed_s);
}

void learn(const WindowProblem& problem, const Unknowns& unknowns, double delay_s, double elapsed_s,
           Equations* equations, WindowEvidence* evidence) {
  const Knowledge knowledge(equations);
  if (!knowledge.root.allFinite()) return;
  VarianceEvidence of_steps, of_drifts;
  for (std::size_t i = 0; i < problem.steps(); ++i) {
    if (problem.is_missed(i)) continue;
    const double dt = problem.duration_s(i);
    const RelativePoseTerms terms = step_terms(problem, unknowns, i);
    const Vec6 variances = knowledge.step_variances(i, dt, problem.drift_of[i], terms);
    evidence->noise.add_step(terms.residual, variances, problem.step_variances(i), dt, &of_steps);
  }
  for (std::size_t k = 0; k < unknowns.drifts.size(); ++k) {
    evidence->noise.add_drift(unknowns.drifts[k], knowledge.drift_variances(k), problem.drift_variances(), &of_drifts);
  }
  // While the odometry's noise is not learnt yet, it is worse than told.
  const double excess = std::max({1.0, of_steps.squares / of_steps.count, of_drifts.squares / of_drifts.count});
  learn_delay(problem, unknowns, knowledge, excess, delay_s, elapsed_s, &evidence->delay);
  const auto last = static_cast<Eigen::Index>(6 * problem.steps());
  const double ends = knowledge.knot_variances(0).tail<3>().mean() + knowledge.knot_variances(last).tail<3>().mean();
  evidence->doubt_radps = std::sqrt(2.0 * ends) / (problem.times_s.back() - problem.times_s.front());
  if (const std::optional<double> variance = box_variance(problem, unknowns)) {
    const double factor = evidence->box_factor * std::sqrt(1.0 + kBoxRate * (*variance - 1.0));
    evidence->box_factor = std::clamp(factor, 1.0 / kMaxBoxFactor, kMaxBoxFactor);
  }
}

/// A second's share of what is not known of each step's motion, behind the step; zero where nothing was missed.
std::vector<Mat6> missed_covariances(const WindowProblem& problem, const Unknowns& unknowns, Equations* equations) {
  std::vector<Mat6> covariances(problem.steps(), Mat6::Zero());
  std::optional<Knowledge> knowledge;
  for (std::size_t i = 0; i < problem.steps(); ++i) {
    if (!problem.is_missed(i)) continue;
    if (!knowledge) knowledge.emplace(equations);
    covariances[i] = knowledge->step_covariance(i, step_terms(problem, unknowns, i)) / problem.missed_s[i];
  }
  return covariances;
}

}  // namespace

struct WindowSolver::Memory {
  Equations equations, spare;
  WindowSolution last;
  std::set<std::int64_t> slipped_to;  ///< stamps of frames to which the odometry slipped from those before
  /// When a slip began, and was found last.
  std::int64_t slipping_since_ns = 0, slipping_ns = 0;
};

WindowSolver::WindowSolver() : memory_(std::make_unique<Memory>()) {}
WindowSolver::~WindowSolver() = default;

std::optional<double> WindowSolver::span_s(double sigma_rad) const {
  if (!(evidence_.doubt_radps > 0.0)) return std::nullopt;
  return 2.0 * sigma_rad / evidence_.doubt_radps;
}

std::optional<Slip> WindowSolver::watch(const std::deque<ObservedFrame>& window) {
  std::set<std::int64_t>& slipped_to = memory_->slipped_to;
  slipped_to.erase(slipped_to.begin(), slipped_to.lower_bound(window.front().stamp_ns));
  const std::map<std::int64_t, SE3>& solved = memory_->last.T_odom_camera;
  if (!solved.empty()) slipped_to.erase(slipped_to.upper_bound(solved.rbegin()->first), slipped_to.end());
  const std::optional<Slip> slip = find_slip(window, memory_->last, noise().odometry, evidence_.delay);
  if (slip) {
    for (std::size_t i = slip->from + 1; i <= slip->to; ++i) slipped_to.insert(window[i].stamp_ns);
  }
  return slip;
}

std::optional<std::int64_t> WindowSolver::last_slipped_ns(const std::deque<ObservedFrame>& window) {
  if (window.size() < 2 || is_lasting(window)) return std::nullopt;
  watch(window);
  const std::set<std::int64_t>& slipped_to = memory_->slipped_to;
  return slipped_to.empty() ? std::nullopt : std::optional(*slipped_to.rbegin());
}

bool WindowSolver::is_lasting(const std::deque<ObservedFrame>& window) const {
  const std::int64_t now_ns = window.back().stamp_ns;
  return now_ns - memory_->slipping_ns < kSlipOver_ns && now_ns - memory_->slipping_since_ns > kLongestSlip_ns;
}

std::deque<ObservedFrame> WindowSolver::solve(std::deque<ObservedFrame> window, std::size_t anchor) {
  applied_delay_s_ = 0.0;
  is_slipping_ = false;
  const auto is_in_order = [](const ObservedFrame& p, const ObservedFrame& q) { return p.stamp_ns < q.stamp_ns; };
  if (std::adjacent_find(window.begin(), window.end(), std::not_fn(is_in_order)) != window.end()) return window;
  const std::vector<std::size_t> knots = knots_of(window, anchor);
  if (knots.size() < kMinWindowViews) return window;
  if (memory_->last.find(window.front().stamp_ns) == nullptr) memory_->last = {};
  std::optional<Slip> slip = watch(window);
  if (slip) {
    const std::int64_t begin_ns = window[slip->from].stamp_ns;
    if (begin_ns - memory_->slipping_ns > kSlipOver_ns) memory_->slipping_since_ns = begin_ns;
    memory_->slipping_ns = window.back().stamp_ns;
  }
  if (is_lasting(window)) {
    memory_->slipped_to.clear();
    slip.reset();
  }
  is_slipping_ = slip.has_value();
  applied_delay_s_ = delay_s();
  window = undelayed(std::move(window), applied_delay_s_);
  std::vector<bool> frozen = frozen_motions(window);
  Unfollowed unfollowed;
  unfollowed.slip = slip;
  unfollowed.bridged = bridge(frozen, anchor, &window);
  for (std::size_t i = 0; i + 1 < window.size(); ++i) {
    frozen[i] = frozen[i] || unfollowed.bridged[i];
    unfollowed.missed.push_back(frozen[i] || memory_->slipped_to.count(window[i + 1].stamp_ns) > 0);
  }
  const WindowProblem problem(window, knots, anchor, unfollowed, noise(), memory_->last);
  Unknowns unknowns;
  if (!core::solve(problem, &unknowns, &memory_->equations, &memory_->spare)) return window;
  const double since_s = 1e-9 * static_cast<double>(window.back().stamp_ns - learnt_ns_);
  if (learnt_ns_ == 0 || since_s >= kLearnInterval_s) {
    evidence_.noise.forget(since_s);
    learn(problem, unknowns, applied_delay_s_, since_s, &memory_->equations, &evidence_);
    learnt_ns_ = window.back().stamp_ns;
  }
  const std::vector<Mat6> covariances = missed_covariances(problem, unknowns, &memory_->equations);
  WindowSolution& last = memory_->last = {};
  std::size_t step = 0;
  for (std::size_t i = 0; i < window.size(); ++i) {
    if (i > 0 && unfollowed.missed[i - 1]) {
      const double time_s = seconds_into(window, i) - seconds_into(window, i - 1);
      (frozen[i - 1] ? window[i].missed.frozen_s : window[i].missed.slipped_s) = time_s;
      window[i].missed.covariance = time_s * covariances[step];
    }
    while (step + 1 < problem.steps() && knots[step + 1] <= i) ++step;
    const double share = (seconds_into(window, i) - problem.times_s[step]) / problem.duration_s(step);
    const SE3& T_odom_knot = unknowns.T_odom_knot[step];
    const SE3 T_knot_camera = problem.T_odom_knot[step].inverse() * window[i].T_odom_camera;
    window[i].T_odom_camera =
        T_odom_knot * motion_on_the_way(T_knot_camera, problem.odometry(step),
                                        T_odom_knot.inverse() * unknowns.T_odom_knot[step + 1], share);
    last.T_odom_camera.emplace_hint(last.T_odom_camera.end(), window[i].stamp_ns, window[i].T_odom_camera);
  }
  for (std::size_t k = 0; k < problem.tracks.size(); ++k) last.objects[problem.tracks[k].id] = unknowns.objects[k];
  return window;
}

}  // namespace semantic_topo_loop::core
