#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "odometry/graph_loop.h"
#include "odometry/odometry_edge.h"

namespace semantic_topo_loop::core {

/// An edge at which the odometry is taken to have jumped: sigmas of what it is off, added to its noise.
struct OdometryJump {
  std::size_t edge = 0;
  double translation_m = 0.0, rotation_rad = 0.0;

  Mat6 covariance() const { return isotropic_covariance(translation_m * translation_m, rotation_rad * rotation_rad); }
};

/// What the odometry's errors are taken to be.
struct NoiseEstimate {
  OdometryNoise odometry;
  double loop_factor = 1.0;  ///< on the sigmas that the loops state
  std::vector<OdometryJump> jumps;
};

/// The linear model of what the loops say about the odometry, y = (how far each loop disagrees with the odometry):
///   y ~ N(u^2 j, f^2 C + s_t^2 G_t + s_r^2 G_r + b_t^2 B_t + b_r^2 B_r + s^2 S + u^2 J + jumps + G_0)
/// with C the loops' covariance (loops that share evidence are correlated), G_t and G_r the random walk per metre and
/// per radian along the path between each loop's ends, B_t and B_r the drift that varies slowly (translation fixed to
/// the camera or to the world), S the scale error, j and J what suspected jumps let expect and leave open, and G_0 of
/// the edges whose covariance is given.
class InnovationModel {
 public:
  /// Linearises about the given poses, which need not be those of the odometry.
  /// @param odometry_begins first vertex of each odometry, ascending: alike noisy, with lasting errors of its own;
  ///     none: there is one
  InnovationModel(const std::vector<SE3>& T_world_vertex, const std::vector<OdometryEdge>& edges,
                  const std::vector<GraphLoop>& loops, const std::vector<int>& odometry_begins = {});

  /// Minus the log likelihood of the innovations, up to a constant.
  double cost(const OdometryNoise& noise, double loop_factor) const;
  /// The jumps that `cost` and the functions below reckon with.
  void set_jumps(const std::vector<OdometryJump>& jumps);
  /// What each edge's lasting errors most probably are, given the innovations, to be put behind its measurement.
  std::vector<Vec6> steady_errors(const NoiseEstimate& noise) const;
  /// Whether these lasting errors are so large a share of the path as no odometry is off all along. Between visits of
  /// the same place every loop is right of an odometry that hardly moves: a scale of next to nothing explains them all.
  bool explains_path_away(const NoiseEstimate& noise) const;
  /// The jump that brings most log likelihood, if it is more than `least_gain`.
  struct Candidate {
    OdometryJump jump;
    double gain = 0.0;
  };
  std::optional<Candidate> best_jump(const NoiseEstimate& noise, double least_gain) const;

 private:
  using Basis = Eigen::Matrix<double, 6, Eigen::Dynamic>;
  struct Whitened {
    Eigen::MatrixXd information;
    Eigen::VectorXd pull;  ///< information * innovation
  };

  /// What the odometry may be off by within an edge: it measured a jump as motion, or missed what the camera did.
  struct MotionBound {
    double translation_m = 0.0, rotation_rad = 0.0;
  };
  MotionBound motion_bound(std::size_t edge) const;

  void accumulate_edges(const std::vector<int>& odometry_begins);
  Basis steady_basis(std::size_t edge) const;
  Eigen::MatrixXd covariance(const OdometryNoise& noise, double loop_factor) const;
  /// What of the misfit suspected jumps do not let expect.
  Eigen::VectorXd innovation(const OdometryNoise& noise) const {
    return misfit_ - noise.jump_prior * noise.jump_prior * expected_jump_;
  }
  Whitened whiten(const NoiseEstimate& noise) const;
  /// A jump of the size that explains most.
  Candidate judge_jump(std::size_t edge, const Whitened& whitened) const;
  /// How a motion error of the edge shows in each innovation.
  Eigen::MatrixXd effect(std::size_t edge) const;
  std::size_t stride() const;

  const std::vector<SE3>* vertices_;
  const std::vector<OdometryEdge>* edges_;
  const std::vector<GraphLoop>* graph_loops_;
  // Of the edges that are modelled.
  /// Of one odometry, in metres: half its path, half what it turns.
  struct Way {
    double length_m = 0.0;
    Eigen::MatrixXd knot_root;      ///< root of the covariance of the steady errors' knots, a row each
    Eigen::Index first_column = 0;  ///< of its steady errors
  };
  struct Progress {
    std::size_t way = 0;
    double before_m = 0.0, step_m = 0.0;  ///< along it
  };
  std::vector<Way> ways_;
  std::vector<Progress> progress_;  ///< one an edge
  double metres_per_radian_ = 0.0;
  MotionBound usual_motion_;  ///< median
  std::size_t modelled_edges_ = 0;
  PathNoise path_;
  std::vector<Basis> sum_steady_;  ///< one a vertex, carried to the first one's place
  std::vector<Mat6> from_origin_;  ///< one a loop
  Eigen::VectorXd misfit_;         ///< how far each loop and the odometry disagree, six rows a loop
  Eigen::VectorXd expected_jump_;  ///< with a prior of 1
  Eigen::MatrixXd given_, translation_, rotation_, suspected_jumps_, loops_, jumps_;
  Eigen::MatrixXd steady_;  ///< how the steady errors show in the innovations
  Eigen::MatrixXd steady_translation_, steady_rotation_, scale_;
};

/// What is expected before any loop is seen, and how far an estimate may go from it.
struct NoisePrior {
  OdometryNoise least;
  double factor_max = 1000.0;  ///< on the least noise
  double evidence = 1.5;       ///< log likelihood to offer for each e-fold above the least
};

struct NoiseFit {
  NoiseEstimate noise;
  double cost =
      0.0;  ///< minus the log posterior, up to a constant: the model's cost, the prior's, and the jumps' price
};

/// Most probable noise given the innovations, with the jumps that `start` states, if they still explain them, and
/// others that do: the cost falls with each. Errors that last are left out where they would explain the path away.
/// Innovations that the loops' own uncertainty explains leave the odometry at a small noise, so that loops then hardly
/// move it.
/// @param max_new_jumps looked for in this call
NoiseFit estimate_noise_and_jumps(InnovationModel* model, const NoisePrior& prior, const NoiseEstimate& start,
                                  int max_new_jumps);

/// A factor on the least noise at which most loops are likely, robust against a minority of false ones: the weighted
/// median over the loops, and one voice for the least noise itself.
/// @param explaining_factors of each loop, see PathNoise   @param weights e.g. 1 / redundancy
double robust_noise_factor(const std::vector<double>& explaining_factors, const std::vector<double>& weights);

}  // namespace semantic_topo_loop::core
