#include "pose_graph/scale/scaled_trajectory.h"

#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>
#include <memory>

#include "geometry/relative_pose.h"

namespace semantic_topo_loop::core {
namespace {

constexpr double kBreakVariance = 1.0;  // of a log scale: after a break the odometry may have begun anew
constexpr double kMinPath_m = 1e-3;     // what a standing camera's edge counts for, so that it stays finite

std::size_t index(int vertex) { return static_cast<std::size_t>(vertex); }

double walk_variance(const OdometryEdge& edge, const PoseGraphOptions& options) {
  return edge.is_break ? kBreakVariance : options.scale_walk * options.scale_walk * std::max(edge.path_m, kMinPath_m);
}

/// How far the scale that a loop states is from the given ones.
double scale_error(const GraphLoop& loop, const std::vector<double>& log_scale) {
  return log_scale[index(loop.to)] - log_scale[index(loop.from)] - std::log(loop.scale);
}

/// Weighted least squares of differences along a chain, the first value being 0.
class ChainSystem {
 public:
  explicit ChainSystem(std::size_t size) : right_(Eigen::VectorXd::Zero(static_cast<Eigen::Index>(size) - 1)) {}

  void add(int from, int to, double difference, double information) {
    accumulate(from, from, information);
    accumulate(to, to, information);
    accumulate(from, to, -information);
    accumulate(to, from, -information);
    if (from > 0) right_(from - 1) -= information * difference;
    if (to > 0) right_(to - 1) += information * difference;
  }
  /// @return whether there is a solution
  bool solve(std::vector<double>* values) const {
    Eigen::SparseMatrix<double> left(right_.size(), right_.size());
    left.setFromTriplets(left_.begin(), left_.end());
    const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> solver(left);
    if (solver.info() != Eigen::Success) return false;
    const Eigen::VectorXd x = solver.solve(right_);
    if (!x.allFinite()) return false;
    for (Eigen::Index i = 0; i < x.size(); ++i) (*values)[static_cast<std::size_t>(i) + 1] = x(i);
    return true;
  }

 private:
  void accumulate(int i, int j, double value) {
    if (i > 0 && j > 0) left_.emplace_back(i - 1, j - 1, value);
  }

  std::vector<Eigen::Triplet<double>> left_;
  Eigen::VectorXd right_;
};

void scale_translation(double scale, Mat6* covariance) {
  covariance->topRows<3>() *= scale;
  covariance->leftCols<3>() *= scale;
}

/// In a unit of length of which `scale` make one of the old.
GraphLoop in_unit(GraphLoop loop, double scale) {
  loop.T_from_to.t *= scale;
  scale_translation(scale, &loop.covariance);
  loop.scale_covariance.head<3>() *= scale;
  return loop;
}

OdometryEdge in_unit(OdometryEdge edge, double scale) {
  edge.T_from_to.t *= scale;
  edge.path_m *= scale;
  edge.suspected_jump.head<3>() *= scale;
  edge.jump_error_m *= scale;
  scale_translation(scale, &edge.missed.covariance);
  if (edge.covariance) scale_translation(scale, &*edge.covariance);
  if (edge.joined) {
    Mat6 unit = Mat6::Identity();
    unit.topLeftCorner<3, 3>() *= scale;
    EdgeCovariance joined = edge.joined->carried(unit);
    joined.translation /= scale;  // it is one for a way of so many metres
    edge.joined = std::make_shared<const EdgeCovariance>(joined);
  }
  return edge;
}

/// An odometry edge of a rigid solution, back in the odometry's unit, with what is known of the scale along it.
SimilarityEdge odometry_edge(const GraphEdge& rigid, double scale, double scale_variance) {
  SimilarityEdge edge{rigid.from, rigid.to, Sim3(rigid.T_from_to), Mat7::Zero(), rigid.weight};
  edge.S_from_to.T.t /= scale;
  edge.sqrt_info.topLeftCorner<6, 6>() = rigid.sqrt_info;
  edge.sqrt_info.topLeftCorner<6, 3>() *= scale;
  edge.sqrt_info(6, 6) = 1.0 / std::sqrt(scale_variance);
  return edge;
}

}  // namespace

std::vector<double> estimate_log_scales(const Trajectory& trajectory, const PoseGraphOptions& options) {
  std::vector<double> log_scale(trajectory.T_map_vertex.size(), 0.0);
  if (log_scale.size() < 2) return log_scale;
  const std::vector<double> copies = redundancy(trajectory.loops);
  // Graduated non-convexity with Geman and McClure's weights: the squared error, in sigmas, at which a loop counts a
  // quarter falls from where it hardly matters.
  constexpr double kWide2 = 1e4, kNarrow2 = 6.0;  // the latter 98.6 % of one degree of freedom
  constexpr int kRounds = 20;                     // eleven to come down by halves, and some to settle
  for (int round = 0; round < kRounds; ++round) {
    const double bend2 = std::max(kNarrow2, kWide2 * std::pow(0.5, round));
    ChainSystem system(log_scale.size());
    for (std::size_t i = 0; i < trajectory.edges.size(); ++i) {
      const int from = static_cast<int>(i);
      system.add(from, from + 1, 0.0, 1.0 / walk_variance(trajectory.edges[i], options));
    }
    for (std::size_t k = 0; k < trajectory.loops.size(); ++k) {
      const GraphLoop& loop = trajectory.loops[k];
      if (!loop.has_scale()) continue;
      const double information = 1.0 / loop.scale_covariance(6), error = scale_error(loop, log_scale);
      const double root_weight = round == 0 ? 1.0 : 1.0 / (1.0 + information * error * error / bend2);
      system.add(loop.from, loop.to, std::log(loop.scale), root_weight * root_weight * information / copies[k]);
    }
    if (!system.solve(&log_scale)) break;
  }
  return log_scale;
}

std::vector<bool> scale_votes(const Trajectory& trajectory, const std::vector<double>& log_scale) {
  constexpr double kSigmas = 3.5;      // as among loops, see LoopConsistency
  constexpr double kTolerance = 0.05;  // of a log scale: what the scales themselves are uncertain by
  std::vector<bool> votes;
  for (const GraphLoop& loop : trajectory.loops) {
    const double sigma = std::sqrt(loop.scale_covariance(6) + kTolerance * kTolerance);
    votes.push_back(!loop.has_scale() || std::abs(scale_error(loop, log_scale)) <= kSigmas * sigma);
  }
  return votes;
}

Trajectory in_map_unit(const Trajectory& trajectory, const std::vector<double>& log_scale) {
  Trajectory scaled = trajectory;
  for (std::size_t i = 0; i < scaled.edges.size(); ++i) {
    scaled.edges[i] = in_unit(std::move(scaled.edges[i]), std::exp(log_scale[i]));
  }
  for (GraphLoop& loop : scaled.loops) {
    const double unit = std::exp(log_scale[index(loop.from)]);
    loop = in_unit(std::move(loop), unit);
  }
  return scaled;
}

bool solve_scales(const Trajectory& trajectory, const OptimizedTrajectory& rigid, const PoseGraphOptions& options,
                  std::vector<SE3>* T_map_vertex, std::vector<double>* log_scale) {
  std::vector<Sim3> vertices;
  for (std::size_t v = 0; v < log_scale->size(); ++v) {
    vertices.emplace_back(rigid.T_map_vertex[v], std::exp((*log_scale)[v]));
  }
  std::vector<SimilarityEdge> edges;
  for (std::size_t i = 0; i < trajectory.edges.size(); ++i) {
    edges.push_back(odometry_edge(rigid.edges[i], vertices[i].scale, walk_variance(trajectory.edges[i], options)));
  }
  for (std::size_t k = 0; k < trajectory.loops.size(); ++k) {
    if (!rigid.knowledge.kept[k]) continue;
    const GraphLoop& loop = trajectory.loops[k];
    edges.push_back({loop.from, loop.to, loop.S_from_to(),
                     similarity_sqrt_info(loop) / rigid.knowledge.noise.loop_factor,
                     rigid.edges[trajectory.edges.size() + k].weight});
  }
  GraphSolverOptions solver_options;
  solver_options.max_iterations = options.max_iterations;
  if (!solve_similarity_graph(edges, solver_options, &vertices).usable) return false;
  for (std::size_t v = 0; v < vertices.size(); ++v) {
    (*T_map_vertex)[v] = vertices[v].T;
    (*log_scale)[v] = std::log(vertices[v].scale);
  }
  return true;
}

double chi_squared(const GraphLoop& loop, const std::vector<SE3>& T_map_vertex, const std::vector<double>& log_scale) {
  const Sim3 S_map_from(T_map_vertex[index(loop.from)], std::exp(log_scale[index(loop.from)]));
  const Sim3 S_map_to(T_map_vertex[index(loop.to)], std::exp(log_scale[index(loop.to)]));
  const Vec7 e = relative_similarity_terms(S_map_from, S_map_to, loop.S_from_to()).residual;
  return (similarity_sqrt_info(loop) * e).squaredNorm();
}

}  // namespace semantic_topo_loop::core
