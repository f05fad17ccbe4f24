#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "odometry/graph_loop.h"
#include "odometry/odometry_edge.h"

namespace semantic_topo_loop::core {

/// Pairwise consistency of loops (after Mangelson et al. 2018): two loops and the odometry between their ends close a
/// cycle, whose error must lie within the loops' noise and a drift that no odometry worth the name exceeds. Loops that
/// disagree with many are outvoted, and where loops agree with each other one that agrees with none has no vote.
class LoopConsistency {
 public:
  /// @param loops those of the last call and new ones behind them
  /// @param eligible one a loop: those that may have a vote; empty: all
  /// @param trusted one a loop: who disagrees with one of these has no vote; empty: none is
  /// @return whether each loop may vote
  std::vector<bool> vote(const std::vector<OdometryEdge>& edges, const std::vector<GraphLoop>& loops,
                         std::vector<bool> eligible = {}, const std::vector<bool>& trusted = {});
  /// Forgets the loops.
  void clear() { relations_.clear(); }
  /// Forgets some of the loops. @param stays one a loop
  void keep(const std::vector<bool>& stays);

 private:
  enum class Relation : std::uint8_t { kOpen, kAgree, kDisagree };
  /// Odometry from the first vertex to a vertex.
  struct Progress {
    SE3 T_first_vertex;
    double path_m = 0.0, turn_rad = 0.0;
    double jump_m2 = 0.0, jump_rad2 = 0.0;  ///< squared sums of suspected jumps
    int breaks = 0;
  };
  struct Stretch {
    SE3 T;
    double sigma_m = 0.0, sigma_rad = 0.0;
    bool is_broken = false;
  };

  Stretch stretch(int from, int to) const;
  Relation compare(const GraphLoop& a, const GraphLoop& b) const;
  void compare_all(const std::vector<OdometryEdge>& edges, const std::vector<GraphLoop>& loops);
  Relation relation(std::size_t a, std::size_t b) const { return relations_[std::max(a, b)][std::min(a, b)]; }
  std::vector<bool> outvote(const std::vector<GraphLoop>& loops, std::vector<bool> votes) const;

  std::vector<Progress> progress_;
  std::vector<std::vector<Relation>> relations_;  ///< of each loop with those before it
};

}  // namespace semantic_topo_loop::core
