#pragma once

#include <vector>

#include "odometry/graph_loop.h"
#include "odometry/odometry_edge.h"

namespace semantic_topo_loop::core {

/// What a loop says about the odometry between its ends.
struct Innovation {
  Mat6 from_origin;  ///< carries a small motion at the world's origin into the loop's error
  Vec6 error;        ///< how far loop and odometry disagree, as the loop's error
  Vec6 jump;         ///< what of that suspected jumps let expect at full suspicion
};

/// The odometry's noise summed along a chain of vertices, carried to the world's origin: the difference of two sums is
/// the noise of the stretch between two vertices. Linear about the given poses, which need not be the odometry's.
class PathNoise {
 public:
  using Sums = std::vector<Mat6>;  ///< one a vertex

  /// @param edges edges[i] joins vertices i and i + 1; both must outlive this
  PathNoise(const std::vector<SE3>& T_world_vertex, const std::vector<OdometryEdge>& edges);

  Innovation innovation(const GraphLoop& loop) const;
  /// Smallest factor on the noise at which a loop is as likely as a typical one (its chi^2 at the median); 0 if it is
  /// so without any odometry noise, infinity if even `max_factor` does not do.
  double explaining_factor(const GraphLoop& loop, const OdometryNoise& noise, double max_factor) const;
  /// Whether the source states a covariance somewhere between the loop's ends.
  bool has_stated(const GraphLoop& loop) const;

  const Sums& given() const { return given_; }              ///< of edges whose covariance does not depend on the noise
  const Sums& translation() const { return translation_; }  ///< per square metre of noise
  const Sums& rotation() const { return rotation_; }        ///< per square radian of noise
  const Sums& suspects() const { return suspects_; }        ///< per square of the suspicion
  /// Carries a small motion at the end of an edge to the world's origin.
  const Mat6& to_origin(std::size_t edge) const { return to_origin_[edge]; }

 private:
  const std::vector<SE3>* vertices_;
  Sums given_, translation_, rotation_, suspects_, to_origin_;
  std::vector<Vec6> residual_, jump_;
  std::vector<int> stated_;
};

}  // namespace semantic_topo_loop::core
