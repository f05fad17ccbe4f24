#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "pose_graph/graph_state.h"
#include "pose_graph/solver/trajectory_optimizer.h"
#include "semantic_topo_loop/pose_graph/pose_graph_options.h"
#include "semantic_topo_loop/types/loop_closure.h"
#include "semantic_topo_loop/types/map_correction.h"

namespace semantic_topo_loop::core {

/// Pairwise consistency of loops (after Mangelson et al. 2018): two loops and the odometry between their ends close a
/// cycle, whose error must lie within the loops' noise and a drift that no odometry worth the name exceeds, beside what
/// it states itself. Loops that disagree with many are outvoted, and where loops agree with each other one that agrees
/// with none has no vote.
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
    Mat6 covariance = Mat6::Zero();         ///< that the source states, or freezes leave; carried to the first vertex
    int stated = 0;                         ///< edges that it is of
    int breaks = 0;
  };
  struct Stretch {
    SE3 T;
    double sigma_m = 0.0, sigma_rad = 0.0;      ///< of any odometry
    double stated_m2 = 0.0, stated_rad2 = 0.0;  ///< beside that, of this one
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

/// The loops that the detector accepted, and which of them are believed. As things are:
///   0. a loop that cannot be an edge is refused; one that repeats what the graph holds stays out of it (`add`);
///   1. consistency among loops (`vote`): pairwise consistency takes the vote from loops that disagree with many;
///   2. robust solve (optimize_trajectory): a loop that would need a much noisier odometry than the others loses its
///      vote, the rest are classified by graduated non-convexity;
///   3. final audit, at the end of a run and after a withdrawal (`reject_outliers`): 1 and 2 once more with what only
///      outliers had outvoted, and once as if loops far off had never come; then audit_clusters, and 1 and 2 without
///      the clusters that it finds.
class LoopRejection {
 public:
  using Chi2 = std::function<double(const GraphLoop&)>;

  explicit LoopRejection(const PoseGraphOptions& options) : options_(options) {}

  /// What the keyframe or vertex of a number moves with.
  using CarrierOf = std::function<Carrier(int)>;

  /// @param query, match numbers of the keyframes, -1 if unknown
  /// @return the loop, until the next call, if it went into the graph; null if it was refused or repeats others
  const GraphLoop* add(const LoopClosure& closure, int query, int match, bool is_extra, const CarrierOf& carrier);
  /// Follows the vertices. @param carrier by the number that a vertex had
  void move(const CarrierOf& carrier);
  /// Bounds what is remembered, once it has been told; what was said last of a loop that is forgotten stands. Of a
  /// graph with more than `most` loops each vertex keeps its best two, the believed ones before the others, then by
  /// their stated errors. Of the loops that repeat others the last thousand stay, to take the place of one that turns
  /// out false.
  void bound(std::size_t most);
  /// Forgets the loops between two keyframes. @return false if none is remembered
  bool withdraw(std::int64_t query_keyframe_id, std::int64_t match_keyframe_id);
  /// Every loop that is remembered, and how many were accepted so far.
  const std::vector<RememberedLoop>& remembered() const { return entries_; }
  std::int64_t accepted() const { return accepted_; }
  /// Goes on with those of an earlier session.
  void restore(std::vector<RememberedLoop> loops, std::int64_t accepted);
  /// Whether one that is remembered ends there, of each of so many vertices.
  std::vector<bool> at_vertices(std::size_t vertices) const;
  /// How many loops are in the graph.
  std::size_t size() const;

  /// Sets the loops of the graph, with what was believed of them.
  void hand_over(Trajectory* trajectory, GraphKnowledge* knowledge) const;
  /// Remembers what is believed of them now.
  void take_back(const Trajectory& trajectory, const GraphKnowledge& knowledge);

  /// Whether each loop may vote. @param has_moved whether those of the last call are not what they were
  std::vector<bool> vote(const Trajectory& trajectory, bool has_moved = false);
  /// Doubts every loop anew, and judges the others as if the outliers had never come.
  /// @param trajectory, knowledge handed over, and voted on   @return false if there is no solution
  bool reject_outliers(Trajectory* trajectory, GraphKnowledge* knowledge);

  /// On the loops of which something else was said before, or nothing, in order of acceptance.
  /// @param chi2 of a loop at the poses found   @param loop_factor on the sigmas that the loops state
  std::vector<LoopVerdict> new_verdicts(const Chi2& chi2, double loop_factor);

 private:
  using Entry = RememberedLoop;
  static bool is_in_graph(const Entry& entry) { return entry.is_in_graph; }

  bool is_repetition(const GraphLoop& loop, std::size_t end) const;
  bool classify(Trajectory* trajectory, GraphKnowledge* knowledge) const;
  bool judge_anew(const std::vector<bool>& outliers, Trajectory* trajectory, GraphKnowledge* knowledge);
  void drop_outliers(const std::vector<bool>& had_vote, Trajectory* trajectory, GraphKnowledge* knowledge);
  LoopVerdict verdict(const Entry& entry, const Chi2& chi2, double loop_factor) const;

  const PoseGraphOptions& options_;
  LoopConsistency consistency_;
  std::vector<Entry> entries_;          ///< in order of acceptance; those in the graph are its loops, in this order
  std::vector<LoopVerdict> withdrawn_;  ///< not told yet
  std::int64_t accepted_ = 0;
};

/// Which of the kept loops stay if the clusters that strain the odometry most are doubted: one goes if, given the other
/// loops and an odometry as noisy, drifting or jumping as all of them together bear out best, it is less likely than
/// false loops that may state any pose. Agreement among its own loops helps it only as far as they are evidence of
/// their own. The worst goes first.
/// @param knowledge of the last optimisation of this trajectory
/// @param settled one a loop: those that are not doubted; empty: none
std::vector<bool> audit_clusters(Trajectory trajectory, const PoseGraphOptions& options, GraphKnowledge knowledge,
                                 const std::vector<bool>& settled = {});

}  // namespace semantic_topo_loop::core
