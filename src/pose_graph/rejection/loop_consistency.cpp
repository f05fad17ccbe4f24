#include <cmath>
#include <utility>

#include "geometry/relative_pose.h"
#include "pose_graph/rejection/loop_rejection.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

// Drift that is allowed between loops, 1 sigma: a tenth of the way, and 2 deg a metre and 3 deg a radian, beside 2 cm
// and 1 deg; no odometry worth the name drifts more.
constexpr double kDrift = 0.1, kDrift_m = 0.02;
constexpr double kTurnPerMetre = 0.035, kTurnPerRadian = 0.05, kTurn_rad = 0.02;
constexpr double kLoopFactor = 2.0;  // loops may overstate their precision
constexpr double kSigmas = 3.5;      // of position and angle each: a right pair exceeds neither 99 times in a hundred
// Beyond these sigmas agreement says nothing: any two loops of one room would agree.
constexpr double kTelling_m = 0.3, kTelling_rad = 0.35;

double squared(double x) { return x * x; }
double mean_sigma(const Mat6& covariance, int first) {
  return std::sqrt(covariance.diagonal().segment<3>(first).mean());
}

}  // namespace

LoopConsistency::Stretch LoopConsistency::stretch(int from, int to) const {
  const Progress& a = progress_[static_cast<std::size_t>(std::min(from, to))];
  const Progress& b = progress_[static_cast<std::size_t>(std::max(from, to))];
  const double path = b.path_m - a.path_m, turn = b.turn_rad - a.turn_rad;
  Stretch stretch;
  const SE3 T = a.T_first_vertex.inverse() * b.T_first_vertex;
  stretch.T = from <= to ? T : T.inverse();
  stretch.sigma_rad = std::sqrt(squared(kTurn_rad + kTurnPerMetre * path + kTurnPerRadian * turn) +
                                std::max(0.0, b.jump_rad2 - a.jump_rad2));
  stretch.sigma_m = std::sqrt(squared(kDrift_m + kDrift * path) + std::max(0.0, b.jump_m2 - a.jump_m2));
  if (a.stated != b.stated) {
    const Mat6 carry = transport(b.T_first_vertex);
    const Vec6 variances = (carry * (b.covariance - a.covariance) * carry.transpose()).diagonal().cwiseMax(0.0);
    stretch.stated_m2 = variances.head<3>().sum();
    stretch.stated_rad2 = variances.tail<3>().sum();
  }
  stretch.is_broken = b.breaks != a.breaks;
  return stretch;
}

LoopConsistency::Relation LoopConsistency::compare(const GraphLoop& a, const GraphLoop& b) const {
  const Stretch first = stretch(a.from, b.from), second = stretch(b.to, a.to);
  if (first.is_broken || second.is_broken) return Relation::kOpen;
  const SE3 rest = b.T_from_to * second.T;
  const SE3 cycle = a.T_from_to.inverse() * (first.T * rest);
  const double angle = rotation_angle(cycle.q, Quaternion::Identity());
  const double loop_rad_a = kLoopFactor * mean_sigma(a.covariance, 3),
               loop_rad_b = kLoopFactor * mean_sigma(b.covariance, 3);
  const double sigma_rad =
      std::sqrt(squared(first.sigma_rad) + squared(second.sigma_rad) + squared(loop_rad_a) + squared(loop_rad_b));
  // What turns the rest of the cycle moves its end.
  const double sigma_m =
      std::sqrt(squared(first.sigma_m) + squared(second.sigma_m) + squared(kLoopFactor * mean_sigma(a.covariance, 0)) +
                squared(kLoopFactor * mean_sigma(b.covariance, 0)) + squared(first.sigma_rad * rest.t.norm()) +
                squared(loop_rad_b * second.T.t.norm()));
  const auto is_within = [&](double more_m2, double more_rad2) {
    return cycle.t.norm() <= kSigmas * std::sqrt(squared(sigma_m) + more_m2) &&
           angle <= kSigmas * std::sqrt(squared(sigma_rad) + more_rad2);
  };
  // An odometry that states a large error may be right all the same: that takes no agreement away.
  const double stated_rad2 = first.stated_rad2 + second.stated_rad2;
  const double stated_m2 = first.stated_m2 + second.stated_m2 + first.stated_rad2 * rest.t.squaredNorm();
  if (!is_within(stated_m2, stated_rad2)) return Relation::kDisagree;
  const bool is_telling = sigma_m < kTelling_m && sigma_rad < kTelling_rad;
  return is_telling && is_within(0.0, 0.0) ? Relation::kAgree : Relation::kOpen;
}

void LoopConsistency::compare_all(const std::vector<OdometryEdge>& edges, const std::vector<GraphLoop>& loops) {
  progress_.assign(1, Progress());
  for (const OdometryEdge& edge : edges) {
    Progress next = progress_.back();
    next.T_first_vertex = next.T_first_vertex * edge.T_from_to;
    next.path_m += edge.path_m;
    next.turn_rad += edge.rotation_rad;
    // Who states how good a motion is states a jump too, if not how large it is.
    const bool is_stated = edge.covariance.has_value();
    if (!is_stated) {
      next.jump_m2 += edge.suspected_jump.head<3>().squaredNorm();
      next.jump_rad2 += edge.suspected_jump.tail<3>().squaredNorm();
    }
    next.breaks += edge.is_break ? 1 : 0;
    if (!edge.is_break && (is_stated || edge.joined || edge.missed.is_any())) {
      const Mat6 to_first = transport(next.T_first_vertex.inverse());
      Mat6 covariance = odometry_covariance(edge, kNoNoise);
      if (is_stated) covariance += edge.suspected_jump * edge.suspected_jump.transpose();
      next.covariance += to_first * covariance * to_first.transpose();
      ++next.stated;
    }
    progress_.push_back(next);
  }
  while (relations_.size() < loops.size()) {
    const GraphLoop& loop = loops[relations_.size()];
    std::vector<Relation> relations;
    for (std::size_t k = 0; k < relations_.size(); ++k) relations.push_back(compare(loops[k], loop));
    relations_.push_back(std::move(relations));
  }
}

void LoopConsistency::keep(const std::vector<bool>& stays) {
  const auto drop = [&stays](auto* list) {
    std::size_t kept = 0;
    for (std::size_t i = 0; i < list->size(); ++i) {
      if (stays[i]) std::swap((*list)[kept++], (*list)[i]);
    }
    list->resize(kept);
  };
  drop(&relations_);
  for (std::vector<Relation>& relations : relations_) drop(&relations);
}

std::vector<bool> LoopConsistency::vote(const std::vector<OdometryEdge>& edges, const std::vector<GraphLoop>& loops,
                                        std::vector<bool> eligible, const std::vector<bool>& trusted) {
  compare_all(edges, loops);
  if (eligible.empty()) eligible.assign(loops.size(), true);
  for (std::size_t a = 0; a < loops.size(); ++a) {
    for (std::size_t b = 0; b < trusted.size() && eligible[a] && !trusted[a]; ++b) {
      if (b != a && trusted[b] && relation(a, b) == Relation::kDisagree) eligible[a] = false;
    }
  }
  return outvote(loops, std::move(eligible));
}

std::vector<bool> LoopConsistency::outvote(const std::vector<GraphLoop>& loops, std::vector<bool> votes) const {
  const std::size_t n = relations_.size();
  std::vector<int> against(n, 0);
  for (std::size_t a = 0; a < n; ++a) {
    for (std::size_t b = 0; b < a; ++b) {
      if (!votes[a] || !votes[b] || relation(a, b) != Relation::kDisagree) continue;
      ++against[a];
      ++against[b];
    }
  }
  // The loop that most disagree with goes first.
  for (std::size_t round = 0; round < n; ++round) {
    const auto worst = static_cast<std::size_t>(std::max_element(against.begin(), against.end()) - against.begin());
    if (against[worst] == 0) break;
    votes[worst] = false;
    against[worst] = 0;
    for (std::size_t b = 0; b < n; ++b) {
      if (b != worst && votes[b] && relation(worst, b) == Relation::kDisagree) --against[b];
    }
  }
  std::vector<bool> is_supported(n, false);
  for (std::size_t a = 0; a < n; ++a) {
    if (votes[a] && loops[a].had_support) is_supported[a] = true;
    for (std::size_t b = 0; b < a; ++b) {
      if (votes[a] && votes[b] && relation(a, b) == Relation::kAgree) is_supported[a] = is_supported[b] = true;
    }
  }
  if (std::find(is_supported.begin(), is_supported.end(), true) == is_supported.end()) return votes;
  return is_supported;
}

}  // namespace semantic_topo_loop::core
