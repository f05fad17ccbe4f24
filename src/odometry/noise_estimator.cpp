#include "odometry/noise_estimator.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "geometry/statistics.h"

namespace semantic_topo_loop::core {
namespace {

/// Two loops from the same windows still differ a little: their keyframes do.
constexpr double kMaxCorrelation = 0.95;

/// After a way of `kForgets_m` the steady errors hang little on what they were. Chosen on the shared drifted files,
/// where 30 and 100 m do alike. They are linear between knots, as far apart as they hardly change in between; where
/// those are too many, for time, farther.
constexpr double kForgets_m = 100.0, kKnotDistance_m = kForgets_m / 3.0, kMaxKnots = 9.0;
/// Columns of a knot: rotation, translation fixed to the camera, translation fixed to the world. The scale comes behind
/// the last knot.
constexpr int kKnotColumns = 9;

Eigen::Index row(std::size_t loop) { return 6 * static_cast<Eigen::Index>(loop); }

double squared(double x) { return x * x; }

/// Root of the covariance of knots so far apart.
Eigen::MatrixXd knot_root(double length_m) {
  const double count = std::clamp(1.0 + std::ceil(length_m / kKnotDistance_m), 2.0, kMaxKnots);
  constexpr double kLeast_m = 1.0;  // nearer knots would be one
  const double distance_m = std::max(length_m, kLeast_m) / (count - 1.0);
  const auto knots = static_cast<Eigen::Index>(count);
  Eigen::MatrixXd covariance(knots, knots);
  for (Eigen::Index i = 0; i < knots; ++i) {
    for (Eigen::Index j = 0; j < knots; ++j) {
      covariance(i, j) = std::exp(-distance_m / kForgets_m * static_cast<double>(std::abs(i - j)));
    }
  }
  return covariance.llt().matrixL();
}

}  // namespace

InnovationModel::Basis InnovationModel::steady_basis(std::size_t edge) const {
  const Progress& progress = progress_[edge];
  const Way& way = ways_[progress.way];
  const Eigen::Index knots = way.knot_root.rows();
  const double step_m = progress.step_m;
  const double share = (progress.before_m + 0.5 * step_m) / std::max(way.length_m, 1e-9);
  const double x = share * static_cast<double>(knots - 1);
  const Eigen::Index knot = std::clamp<Eigen::Index>(static_cast<Eigen::Index>(x), 0, knots - 2);
  const double ratio = x - static_cast<double>(knot);
  const Eigen::RowVectorXd at = (1.0 - ratio) * way.knot_root.row(knot) + ratio * way.knot_root.row(knot + 1);
  const Mat3 R_vertex_world = (*vertices_)[edge + 1].q.conjugate().normalized().toRotationMatrix();
  Basis basis = Basis::Zero(6, steady_.cols());
  for (Eigen::Index k = 0; k < knots; ++k) {
    const Eigen::Index column = way.first_column + k * kKnotColumns;
    basis.block<3, 3>(3, column) = step_m * at(k) * Mat3::Identity();
    basis.block<3, 3>(0, column + 3) = step_m * at(k) * Mat3::Identity();
    basis.block<3, 3>(0, column + 6) = step_m * at(k) * R_vertex_world;
  }
  const SE3& T_from_to = (*edges_)[edge].T_from_to;
  basis.col(way.first_column + knots * kKnotColumns).head<3>() = T_from_to.q.conjugate() * T_from_to.t;
  return basis;
}

void InnovationModel::accumulate_edges(const std::vector<int>& odometry_begins) {
  const std::size_t n = edges_->size() + 1;
  double path = 0.0, turn = 0.0;
  std::vector<double> paths, turns;
  for (const OdometryEdge& edge : *edges_) {
    if (!edge.is_modelled()) continue;
    paths.push_back(edge.path_m);
    turns.push_back(edge.rotation_rad);
    path += edge.path_m;
    turn += edge.rotation_rad;
  }
  modelled_edges_ = paths.size();
  usual_motion_ = {median(std::move(paths)), median(std::move(turns))};
  metres_per_radian_ = turn > 0.0 ? path / turn : 0.0;
  progress_.resize(n - 1);
  std::ptrdiff_t last = -1;
  for (std::size_t i = 0; i + 1 < n; ++i) {
    const OdometryEdge& edge = (*edges_)[i];
    if (!edge.is_modelled()) continue;
    const auto begins = std::upper_bound(odometry_begins.begin(), odometry_begins.end(), static_cast<int>(i));
    if (begins - odometry_begins.begin() != last) ways_.emplace_back();
    last = begins - odometry_begins.begin();
    const double step_m = 0.5 * (edge.path_m + metres_per_radian_ * edge.rotation_rad);
    progress_[i] = {ways_.size() - 1, ways_.back().length_m, step_m};
    ways_.back().length_m += step_m;
  }
  Eigen::Index columns = 0;
  for (Way& way : ways_) {
    way.first_column = columns;
    way.knot_root = knot_root(way.length_m);
    columns += way.knot_root.rows() * kKnotColumns + 1;
  }
  steady_.resize(row(graph_loops_->size()), columns);
  sum_steady_.assign(n, Basis::Zero(6, steady_.cols()));
  for (std::size_t i = 0; i + 1 < n; ++i) {
    sum_steady_[i + 1] = sum_steady_[i];
    const OdometryEdge& edge = (*edges_)[i];
    if (edge.is_modelled()) sum_steady_[i + 1] += path_.to_origin(i) * steady_basis(i);
  }
}

InnovationModel::InnovationModel(const std::vector<SE3>& T_world_vertex, const std::vector<OdometryEdge>& edges,
                                 const std::vector<GraphLoop>& loops, const std::vector<int>& odometry_begins)
    : vertices_(&T_world_vertex), edges_(&edges), graph_loops_(&loops), path_(T_world_vertex, edges) {
  accumulate_edges(odometry_begins);
  const auto n = row(loops.size());
  misfit_.resize(n);
  expected_jump_.resize(n);
  for (Eigen::MatrixXd* m : {&given_, &translation_, &rotation_, &suspected_jumps_, &loops_, &jumps_}) m->setZero(n, n);
  std::vector<Mat6> roots(loops.size());
  from_origin_.resize(loops.size());
  for (std::size_t k = 0; k < loops.size(); ++k) {
    const GraphLoop& loop = loops[k];
    const auto from = static_cast<std::size_t>(loop.from), to = static_cast<std::size_t>(loop.to);
    const Innovation innovation = path_.innovation(loop);
    from_origin_[k] = innovation.from_origin;
    misfit_.segment<6>(row(k)) = innovation.error;
    expected_jump_.segment<6>(row(k)) = innovation.jump;
    steady_.middleRows<6>(row(k)) = from_origin_[k] * (sum_steady_[to] - sum_steady_[from]);
    roots[k] = loop.covariance.llt().matrixL();
  }
  for (std::size_t k = 0; k < loops.size(); ++k) {
    for (std::size_t l = 0; l <= k; ++l) {
      const auto begin = static_cast<std::size_t>(std::max(loops[k].from, loops[l].from));
      const auto end = static_cast<std::size_t>(std::min(loops[k].to, loops[l].to));
      const double shared = k == l ? 1.0 : std::min(kMaxCorrelation, shared_evidence(loops[k], loops[l]));
      loops_.block<6, 6>(row(k), row(l)) = shared * roots[k] * roots[l].transpose();
      if (begin >= end) continue;
      const auto between = [&](Mat6 EdgeCovariance::*cause) {
        const Mat6 difference = path_.sums()[end].*cause - path_.sums()[begin].*cause;
        return Mat6(from_origin_[k] * difference * from_origin_[l].transpose());
      };
      given_.block<6, 6>(row(k), row(l)) = between(&EdgeCovariance::given);
      translation_.block<6, 6>(row(k), row(l)) = between(&EdgeCovariance::translation);
      rotation_.block<6, 6>(row(k), row(l)) = between(&EdgeCovariance::rotation);
      suspected_jumps_.block<6, 6>(row(k), row(l)) = between(&EdgeCovariance::suspected_jumps);
    }
  }
  for (Eigen::MatrixXd* m : {&steady_rotation_, &steady_translation_, &scale_}) m->setZero(n, n);
  for (const Way& way : ways_) {
    Eigen::Index column = way.first_column;
    for (Eigen::Index knot = 0; knot < way.knot_root.rows(); ++knot, column += kKnotColumns) {
      const auto turning = steady_.middleCols<3>(column);
      const auto moving = steady_.middleCols<6>(column + 3);
      steady_rotation_ += turning * turning.transpose();
      steady_translation_ += moving * moving.transpose();
    }
    scale_ += steady_.col(column) * steady_.col(column).transpose();
  }
}

Eigen::MatrixXd InnovationModel::effect(std::size_t edge) const {
  Eigen::MatrixXd result = Eigen::MatrixXd::Zero(misfit_.size(), 6);
  for (std::size_t k = 0; k < graph_loops_->size(); ++k) {
    const GraphLoop& loop = (*graph_loops_)[k];
    const int i = static_cast<int>(edge);
    if (loop.from <= i && i < loop.to) result.middleRows<6>(row(k)) = from_origin_[k] * path_.to_origin(edge);
  }
  return result;
}

void InnovationModel::set_jumps(const std::vector<OdometryJump>& jumps) {
  jumps_.setZero();
  for (const OdometryJump& jump : jumps) {
    const Eigen::MatrixXd by_error = effect(jump.edge);
    jumps_ += by_error * jump.covariance() * by_error.transpose();
  }
}

/// Only the lower triangle is meant.
Eigen::MatrixXd InnovationModel::covariance(const OdometryNoise& noise, double loop_factor) const {
  Eigen::MatrixXd sum = squared(loop_factor) * loops_ + given_ + jumps_;
  sum += squared(noise.translation_m) * translation_ + squared(noise.rotation_rad) * rotation_;
  sum += squared(noise.steady_translation) * steady_translation_ + squared(noise.scale) * scale_;
  sum += squared(noise.steady_rotation_rad) * steady_rotation_ + squared(noise.jump_prior) * suspected_jumps_;
  return sum;
}

double InnovationModel::cost(const OdometryNoise& noise, double loop_factor) const {
  Eigen::MatrixXd covariance = this->covariance(noise, loop_factor);
  const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>, Eigen::Lower> factor(covariance);
  if (factor.info() != Eigen::Success) return std::numeric_limits<double>::infinity();
  const Eigen::VectorXd whitened = factor.matrixL().solve(innovation(noise));
  return 0.5 * whitened.squaredNorm() + covariance.diagonal().array().log().sum();
}

InnovationModel::Whitened InnovationModel::whiten(const NoiseEstimate& noise) const {
  const Eigen::MatrixXd covariance = this->covariance(noise.odometry, noise.loop_factor);
  const Eigen::LLT<Eigen::MatrixXd, Eigen::Lower> factor(covariance);
  Whitened whitened;
  whitened.information = factor.solve(Eigen::MatrixXd::Identity(covariance.rows(), covariance.cols()));
  whitened.pull = factor.solve(innovation(noise.odometry));
  return whitened;
}

std::vector<Vec6> InnovationModel::steady_errors(const NoiseEstimate& noise) const {
  const Eigen::VectorXd pull = whiten(noise).pull;
  Eigen::VectorXd weights = -(steady_.transpose() * pull);
  for (const Way& way : ways_) {
    Eigen::Index column = way.first_column;
    for (Eigen::Index knot = 0; knot < way.knot_root.rows(); ++knot, column += kKnotColumns) {
      weights.segment<3>(column) *= squared(noise.odometry.steady_rotation_rad);
      weights.segment<6>(column + 3) *= squared(noise.odometry.steady_translation);
    }
    weights(column) *= squared(noise.odometry.scale);
  }
  std::vector<Vec6> errors(edges_->size(), Vec6::Zero());
  for (std::size_t i = 0; i < errors.size(); ++i) {
    if ((*edges_)[i].is_modelled()) errors[i] = steady_basis(i) * weights;
  }
  return errors;
}

std::size_t InnovationModel::stride() const {
  constexpr std::size_t kMaxCandidates =
      250;  // bounds the time of a search in long runs; neighbours tell nearly the same
  return 1 + modelled_edges_ / kMaxCandidates;
}

InnovationModel::MotionBound InnovationModel::motion_bound(std::size_t edge) const {
  const std::size_t reach = stride() - 1;  // a jump stands for those of its neighbours too
  const std::size_t first = edge - std::min(edge, reach), last = std::min(edges_->size() - 1, edge + reach);
  MotionBound bound;
  for (std::size_t i = first; i <= last; ++i) {
    bound.translation_m = std::max(bound.translation_m, (*edges_)[i].path_m);
    bound.rotation_rad = std::max(bound.rotation_rad, (*edges_)[i].rotation_rad);
  }
  constexpr double kTrueMotion = 2.0;  // times the usual one: what the camera itself may have done meanwhile
  bound.translation_m += kTrueMotion * usual_motion_.translation_m;
  bound.rotation_rad += kTrueMotion * usual_motion_.rotation_rad;
  return bound;
}

InnovationModel::Candidate InnovationModel::judge_jump(std::size_t edge, const Whitened& whitened) const {
  const Eigen::MatrixXd by_error = effect(edge);
  const Mat6 information = by_error.transpose() * whitened.information * by_error;
  const Vec6 pull = by_error.transpose() * whitened.pull;
  const MotionBound bound = motion_bound(edge);
  // Sigmas by fixed point: the estimate under a wide prior, then the prior that fits the estimate.
  Candidate candidate{{edge, 1.0, 1.0}, 0.0};
  constexpr int kRounds = 3;  // few: they only have to rank the edges and to set a prior
  for (int round = 0;; ++round) {
    const Mat6 prior = candidate.jump.covariance();
    const Mat6 inner = Mat6::Identity() + prior * information;
    const Vec6 estimate = inner.partialPivLu().solve(prior * pull);
    candidate.gain = 0.5 * pull.dot(estimate) - 0.5 * std::log(std::max(inner.determinant(), 1.0));
    if (round == kRounds) return candidate;
    constexpr double kRootThree = 1.7320508;  // from the norm of three axes to one
    candidate.jump.translation_m = std::min(estimate.head<3>().norm(), bound.translation_m) / kRootThree;
    candidate.jump.rotation_rad = std::min(estimate.tail<3>().norm(), bound.rotation_rad) / kRootThree;
  }
}

bool InnovationModel::explains_path_away(const NoiseEstimate& noise) const {
  constexpr double kMaxShare = 0.3;
  const std::vector<Vec6> errors = steady_errors(noise);
  double path_m = 0.0, error_m = 0.0;
  for (std::size_t i = 0; i < errors.size(); ++i) {
    if ((*edges_)[i].is_modelled()) path_m += (*edges_)[i].path_m;
    error_m += errors[i].head<3>().norm();
  }
  return error_m > kMaxShare * path_m;
}

std::optional<InnovationModel::Candidate> InnovationModel::best_jump(const NoiseEstimate& noise,
                                                                     double least_gain) const {
  const Whitened whitened = whiten(noise);
  std::optional<Candidate> best;
  for (std::size_t edge = 0; edge < edges_->size(); edge += stride()) {
    if (!(*edges_)[edge].is_modelled()) continue;
    const Candidate candidate = judge_jump(edge, whitened);
    if (candidate.gain > (best ? best->gain : least_gain)) best = candidate;
  }
  return best;
}

namespace {

/// Logarithms of the factors on the least noise (first kWalks: translation and rotation walk; then steady translation
/// and rotation, scale, prior of suspected jumps) and on the loops' sigmas.
constexpr std::size_t kWalks = 2, kJumpPriorIndex = 5, kLoopIndex = 6;
using LogFactors = std::array<double, kLoopIndex + 1>;

/// Of the evidence asked for: every odometry drifts, and the least is next to nothing.
constexpr double kSteadyShare = 0.3;
constexpr double kLogSigmaLoop = 0.35;  // a loop's sigmas are trusted to about 40 %
constexpr double kMaxLogLoop = 1.0;     // and to a factor of e at most: three sigmas of that

std::array<double, kLoopIndex> values(const OdometryNoise& noise) {
  return {noise.translation_m,       noise.rotation_rad, noise.steady_translation,
          noise.steady_rotation_rad, noise.scale,        noise.jump_prior};
}

NoiseEstimate to_estimate(const LogFactors& x, const NoisePrior& prior, const std::vector<OdometryJump>& jumps) {
  const auto least = values(prior.least);
  const auto at = [&](std::size_t i) { return least[i] * std::exp(x[i]); };
  return {{at(0), at(1), at(2), at(3), at(4), at(kJumpPriorIndex)}, std::exp(x[kLoopIndex]), jumps};
}

double penalty(const LogFactors& x, const NoisePrior& prior) {
  double sum = 0.5 * x[kLoopIndex] * x[kLoopIndex] / (kLogSigmaLoop * kLogSigmaLoop);
  for (std::size_t i = 0; i < kLoopIndex; ++i) sum += prior.evidence * x[i] * (i < kWalks ? 1.0 : kSteadyShare);
  return sum;
}

/// The walks are doubted step by step only: coherent errors of a few loops look like a restless odometry from afar. A
/// steady drift shows only from afar.
constexpr double kMaxWalkStep = 0.8;

struct Steps {
  double first, last;
};
constexpr Steps kWide{3.2, 0.1}, kNear{0.8, 0.15};  ///< of the logarithms

NoiseFit fit_noise(const InnovationModel& model, const NoisePrior& prior, const NoiseEstimate& start,
                   const Steps& steps) {
  LogFactors highs{}, best{};
  highs.fill(std::log(prior.factor_max));
  highs[kLoopIndex] = kMaxLogLoop;
  best[kLoopIndex] = std::log(start.loop_factor);
  const auto least = values(prior.least), first = values(start.odometry);
  for (std::size_t i = 0; i < kLoopIndex; ++i) {
    if (least[i] <= 0.0) highs[i] = 0.0;  // switched off
    if (i == kJumpPriorIndex) highs[i] = -std::log(std::max(least[i], 1e-9));
    best[i] = least[i] > 0.0 && first[i] > 0.0 ? std::log(first[i] / least[i]) : 0.0;
  }
  for (std::size_t i = 0; i < best.size(); ++i) best[i] = std::clamp(best[i], 0.0, highs[i]);
  const auto cost = [&](const LogFactors& x) {
    const NoiseEstimate estimate = to_estimate(x, prior, {});
    return model.cost(estimate.odometry, estimate.loop_factor) + penalty(x, prior);
  };
  double best_cost = cost(best);
  // Compass search: a few smooth parameters, each evaluation one small Cholesky.
  for (double step = steps.first; step > steps.last;) {
    bool moved = false;
    for (std::size_t i = 0; i < best.size(); ++i) {
      for (const double sign : {1.0, -1.0}) {
        LogFactors x = best;
        x[i] = std::clamp(x[i] + sign * std::min(step, i < kWalks ? kMaxWalkStep : step), 0.0, highs[i]);
        if (x[i] == best[i]) continue;
        const double value = cost(x);
        if (!(value < best_cost)) continue;
        best = x;
        best_cost = value;
        moved = true;
        break;
      }
    }
    if (!moved) step *= 0.5;
  }
  return {to_estimate(best, prior, start.jumps), best_cost};
}

/// Log likelihood that a jump must bring, since where (one in some hundred edges: 5 to 6) and how far on six axes (1
/// each) it is are free.
constexpr double kJumpPrice = 12.0;

}  // namespace

NoiseFit estimate_noise_and_jumps(InnovationModel* model, const NoisePrior& given, const NoiseEstimate& start,
                                  int max_new_jumps) {
  model->set_jumps(start.jumps);
  // Suspected jumps come first: from a prior of next to nothing a step up may bring nothing where a prior of 1 does.
  NoiseEstimate doubtful = start;
  doubtful.odometry.jump_prior = 1.0;
  NoisePrior prior = given;
  NoiseFit best = fit_noise(*model, prior, doubtful, kWide);
  if (model->explains_path_away(best.noise)) {
    prior.least.steady_translation = prior.least.steady_rotation_rad = prior.least.scale = 0.0;
    best = fit_noise(*model, prior, doubtful, kWide);
  }
  best.cost += kJumpPrice * static_cast<double>(best.noise.jumps.size());
  const auto attempt = [&](const std::vector<OdometryJump>& jumps) {
    model->set_jumps(jumps);
    NoiseEstimate next = best.noise;
    next.jumps = jumps;
    NoiseFit fit = fit_noise(*model, prior, next, kNear);
    fit.cost += kJumpPrice * static_cast<double>(jumps.size());
    const bool is_better = fit.cost < best.cost;
    if (is_better) best = std::move(fit);
    model->set_jumps(best.noise.jumps);
    return is_better;
  };
  for (std::size_t i = best.noise.jumps.size(); i-- > 0;) {
    std::vector<OdometryJump> fewer = best.noise.jumps;
    fewer.erase(fewer.begin() + static_cast<std::ptrdiff_t>(i));
    attempt(fewer);
  }
  for (int i = 0; i < max_new_jumps; ++i) {
    const auto candidate = model->best_jump(best.noise, 0.5 * kJumpPrice);
    if (!candidate) break;
    std::vector<OdometryJump> more = best.noise.jumps;
    more.push_back(candidate->jump);
    if (!attempt(more)) break;
  }
  return best;
}

double robust_noise_factor(const std::vector<double>& explaining_factors, const std::vector<double>& weights) {
  std::vector<std::pair<double, double>> factors{{1.0, 1.0}};  // factor, weight
  double total = 1.0;
  for (std::size_t k = 0; k < explaining_factors.size(); ++k) {
    factors.emplace_back(explaining_factors[k], weights[k]);
    total += weights[k];
  }
  std::sort(factors.begin(), factors.end());
  double below = 0.0;
  for (const auto& [factor, weight] : factors) {
    below += weight;
    if (below >= 0.5 * total) return factor;
  }
  return factors.back().first;
}

}  // namespace semantic_topo_loop::core
