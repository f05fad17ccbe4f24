#pragma once

#include <deque>
#include <optional>
#include <vector>

#include "geometry/pose_consensus.h"
#include "semantic_topo_loop/types/loop_closure.h"

namespace semantic_topo_loop::core {

/// Consensus of loops into an earlier run's map: the largest group that agrees on where its cameras are, and the pose
/// that fits the group best, weighed by the loops' covariances. The last thousand loops count, since odometry drifts.
class Relocaliser {
 public:
  /// Takes in an accepted loop with T_earlier_match; others are ignored.
  /// @param T_odom_query pose of the camera at the loop's query_frame
  void add(const LoopClosure& loop, const SE3& T_odom_query);
  /// Forgets the loops, at a break of the odometry or a jump that boxes show: those behind it tell of another world.
  void restart() { *this = Relocaliser(); }
  /// Made when it is asked for, once for the same loops.
  /// @return nullopt until three loops agree and outnumber the others
  const std::optional<Relocalisation>& estimate();

 private:
  /// Where the query is in the earlier map (a) and in the odometry's world (b).
  struct Vote : PosePair {
    Mat6 information;  ///< of T_a_x: (translation m, rotation rad), right
  };
  std::optional<Relocalisation> consensus() const;
  std::vector<const Vote*> supporters(const SE3& T_earlier_odom) const;
  static SE3 fit(const std::vector<const Vote*>& votes, SE3 T_earlier_odom);

  std::deque<Vote> votes_;
  std::optional<Relocalisation> estimate_;
  bool is_current_ = true;  ///< estimate_ is by all votes
};

}  // namespace semantic_topo_loop::core
