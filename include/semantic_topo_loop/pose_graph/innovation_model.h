#pragma once

#include <Eigen/Core>
#include <vector>

#include "semantic_topo_loop/pose_graph/graph_loop.h"
#include "semantic_topo_loop/pose_graph/odometry_edge.h"

namespace semantic_topo_loop::core {

/// The linear model of what the loops say about the odometry, y = (how far each loop disagrees with the odometry):
///   y ~ N(0, f^2 C + s_t^2 G_t + s_r^2 G_r + G_0)
/// with C the loops' covariance (loops that share evidence are correlated), G_t and G_r the odometry's noise per metre
/// and per radian along the path between each loop's ends, and G_0 of the edges whose covariance is given.
class InnovationModel {
 public:
  /// Linearises about the given poses, which need not be those of the odometry.
  InnovationModel(const std::vector<SE3>& T_world_vertex, const std::vector<OdometryEdge>& edges,
                  const std::vector<GraphLoop>& loops);

  /// Minus the log likelihood of the innovations, up to a constant.
  double cost(const OdometryNoise& noise, double loop_factor) const;
  /// Smallest factor on the noise at which loop k is as likely as a typical one (its chi^2 at the median); 0 if it is
  /// so without any odometry noise, infinity if even `max_factor` does not do.
  double explaining_factor(std::size_t k, const OdometryNoise& noise, double max_factor) const;
  std::size_t size() const { return loop_covariances_.size(); }

 private:
  void accumulate_edges(const std::vector<SE3>& T_world_vertex, const std::vector<OdometryEdge>& edges);

  /// Running sums over the edges of B D B^T, B the transport to the world's origin: differences of two of them give
  /// the noise of any stretch of the path.
  std::vector<Mat6> sum_given_, sum_translation_, sum_rotation_;
  std::vector<Vec6> sum_residual_;
  Eigen::VectorXd innovation_;
  std::vector<Mat6> loop_covariances_;
  Eigen::MatrixXd given_, translation_, rotation_, loops_;
};

}  // namespace semantic_topo_loop::core
