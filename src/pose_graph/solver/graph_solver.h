#pragma once

#include <string>
#include <vector>

#include "pose_graph/solver/graph_objects.h"
#include "semantic_topo_loop/types/transform.h"

namespace semantic_topo_loop::core {

/// A measured relative pose between two vertices.
struct GraphEdge {
  int from = -1, to = -1;
  SE3 T_from_to;
  Mat6 sqrt_info = Mat6::Identity();  ///< U of |U e|^2 = e^T covariance^-1 e, e as in relative_pose.h
  double weight = 1.0;                ///< factor on |U e|^2, >= 0; an edge of weight 0 is left out
  bool robust = false;                ///< whether the loss applies to it

  bool is_finite() const { return T_from_to.is_finite(); }
};

enum class GraphLoss { kNone, kHuber, kCauchy };

enum class GraphError {
  kLog,        ///< e = (translation, rotation vector), see relative_pose.h
  kQuaternion  ///< e = (translation, vector part of the quaternion), as g2o has it
};

struct GraphSolverOptions {
  GraphError error = GraphError::kLog;
  std::vector<int> fixed{0};  ///< vertices that stay where they are, at least one
  GraphLoss loss = GraphLoss::kNone;
  double loss_chi2 = 16.8;  ///< |U e|^2 at which the loss begins to bend
  int max_iterations = 30;
  double function_tolerance = 1e-6;
  /// For graphs whose factor fills in (many loops all over a sphere): supernodal factorisation, where there is one.
  bool has_fill = false;
};

struct GraphSolution {
  bool usable = false;
  bool converged = false;                       ///< a tolerance ended it, not the number of iterations
  double initial_cost = 0.0, final_cost = 0.0;  ///< 0.5 sum w |U e|^2, after the loss
  int iterations = 0;
  std::string message;  ///< why it is not usable
};

/// Minimises 0.5 sum w |U e|^2 over the poses (Ceres, one thread, Levenberg-Marquardt).
/// @param T_world_vertex start and result; unchanged unless the solution is usable
/// @param objects unknowns beside the poses; their observations add to the cost
GraphSolution solve_graph(const std::vector<GraphEdge>& edges, const GraphSolverOptions& options,
                          std::vector<SE3>* T_world_vertex, const GraphObjects& objects = {});

/// A measured relative similarity between two vertices.
struct SimilarityEdge {
  int from = -1, to = -1;
  Sim3 S_from_to;  ///< its translation in from's unit
  /// U of |U e|^2, e as in RelativeSimilarityTerms; rows of zeros where nothing was measured.
  Mat7 sqrt_info = Mat7::Identity();
  double weight = 1.0;  ///< factor on |U e|^2, >= 0; an edge of weight 0 is left out

  bool is_finite() const { return S_from_to.is_finite(); }
};

/// The same over similarities; `error` and `loss` are not used, the fixed vertices keep their scale too.
GraphSolution solve_similarity_graph(const std::vector<SimilarityEdge>& edges, const GraphSolverOptions& options,
                                     std::vector<Sim3>* S_world_vertex);

/// |U e|^2 of an edge, without its weight.
double chi_squared(const GraphEdge& edge, const std::vector<SE3>& T_world_vertex, GraphError error = GraphError::kLog);

struct LoopClassification {
  bool usable = false;
  std::vector<bool> kept;           ///< one a loop edge, in their order
  std::vector<SE3> T_world_vertex;  ///< the poses at which it was decided
};

/// Tells right loops from false ones by graduated non-convexity with truncated least squares (Yang et al. 2020): the
/// cost min(|U e|^2, chi2) of each loop, reached from its convex surrogate through a series of weighted solves.
/// @param edges odometry edges and loop edges; those flagged robust are classified, their weight is a factor
/// @param guess of each loop edge: if a solve with the guessed ones alone bears it out, it stands. Without a guess, or
///        if it fails, all are judged anew
LoopClassification classify_loops(const std::vector<GraphEdge>& edges, double chi2, const GraphSolverOptions& options,
                                  const std::vector<SE3>& T_world_vertex, const std::vector<bool>& guess = {});

}  // namespace semantic_topo_loop::core
