#include "loop/graph/relocalisation.h"

#include <Eigen/Cholesky>
#include <utility>

#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

constexpr std::size_t kMinAgreeing = 3;  ///< two may be one mistake made twice
constexpr std::size_t kMaxVotes = 1000;  ///< the latest: the odometry drifts away from the earlier ones
constexpr int kRounds = 3;               ///< of fit and supporters
constexpr int kIterations = 5;           ///< of Gauss-Newton, which starts from a loop that most agree with

}  // namespace

void Relocaliser::add(const LoopClosure& loop, const SE3& T_odom_query) {
  if (!loop.accepted || !loop.T_earlier_match || !T_odom_query.is_finite()) return;
  if (!loop.covariance.allFinite()) return;
  const Eigen::LDLT<Mat6> ldlt(loop.covariance);
  if (ldlt.info() != Eigen::Success || !ldlt.isPositive()) return;
  const Mat6 information = ldlt.solve(Mat6::Identity());
  if (!information.allFinite()) return;
  votes_.push_back({{*loop.T_earlier_match * loop.T_match_query, T_odom_query}, information});
  if (votes_.size() > kMaxVotes) votes_.pop_front();
  is_current_ = false;
}

const std::optional<Relocalisation>& Relocaliser::estimate() {
  if (!std::exchange(is_current_, true)) estimate_ = consensus();
  return estimate_;
}

std::vector<const Relocaliser::Vote*> Relocaliser::supporters(const SE3& T_earlier_odom) const {
  std::vector<const Vote*> agreeing;
  for (const Vote& vote : votes_) {
    if (agrees(vote, T_earlier_odom)) agreeing.push_back(&vote);
  }
  return agreeing;
}

/// Gauss-Newton on r_i = (R_i^T (p - p_i), log(R_i^T R)), where (R, p) = T_earlier_odom T_odom_query_i.
SE3 Relocaliser::fit(const std::vector<const Vote*>& votes, SE3 T_earlier_odom) {
  for (int i = 0; i < kIterations; ++i) {
    Mat6 H = Mat6::Zero();
    Vec6 g = Vec6::Zero();
    for (const Vote* vote : votes) {
      const Vec6 r = se3_log(vote->T_a_x.inverse() * (T_earlier_odom * vote->T_b_x));
      Mat6 J = Mat6::Zero();
      J.topLeftCorner<3, 3>() = vote->T_a_x.rotation().transpose() * T_earlier_odom.rotation();
      J.topRightCorner<3, 3>() = -J.topLeftCorner<3, 3>() * hat(vote->T_b_x.t);
      J.bottomRightCorner<3, 3>() = vote->T_b_x.rotation().transpose();
      const double weight = 1.0 / (1.0 + r.dot(vote->information * r));  // Cauchy
      H += weight * J.transpose() * vote->information * J;
      g += weight * J.transpose() * vote->information * r;
    }
    const Vec6 step = -H.ldlt().solve(g);
    if (!step.allFinite()) break;
    T_earlier_odom = T_earlier_odom * se3_exp(step);
  }
  return T_earlier_odom;
}

std::optional<Relocalisation> Relocaliser::consensus() const {
  SE3 T_earlier_odom = most_supported(votes_).T_a_b;
  std::vector<const Vote*> best = supporters(T_earlier_odom);
  for (int round = 0; round < kRounds && best.size() >= kMinAgreeing; ++round) {
    T_earlier_odom = fit(best, T_earlier_odom);
    best = supporters(T_earlier_odom);
  }
  if (best.size() < kMinAgreeing || 2 * best.size() <= votes_.size()) return std::nullopt;
  return Relocalisation{T_earlier_odom, static_cast<int>(best.size()), static_cast<int>(votes_.size())};
}

}  // namespace semantic_topo_loop::core
