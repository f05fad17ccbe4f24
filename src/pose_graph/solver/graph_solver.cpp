#include "pose_graph/solver/graph_solver.h"

#include <algorithm>
#include <cmath>

#include "geometry/ceres_compat.h"
#include "geometry/relative_pose.h"
#include "pose_graph/solver/graph_problem.h"
#include "pose_graph/solver/object_blocks.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

using RowMat63 = Eigen::Matrix<double, 6, 3, Eigen::RowMajor>;
using RowMat64 = Eigen::Matrix<double, 6, 4, Eigen::RowMajor>;

Vec6 residual(const SE3& T_world_from, const SE3& T_world_to, const SE3& T_from_to, GraphError error) {
  return error == GraphError::kLog ? relative_pose_residual(T_world_from, T_world_to, T_from_to)
                                   : quaternion_pose_residual(T_world_from, T_world_to, T_from_to);
}

/// sqrt(w) U e(T_z^-1 T_from^-1 T_to) over (t_from, q_from, t_to, q_to).
class RelativePoseCost : public ceres::SizedCostFunction<6, 3, 4, 3, 4> {
 public:
  RelativePoseCost(const GraphEdge& edge, GraphError error)
      : error_(error), T_from_to_(edge.T_from_to), sqrt_info_(std::sqrt(edge.weight) * edge.sqrt_info) {}

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const SE3 T_world_from{Quaternion(parameters[1]), Vec3(parameters[0])};
    const SE3 T_world_to{Quaternion(parameters[3]), Vec3(parameters[2])};
    Eigen::Map<Vec6> e(residuals);
    if (jacobians == nullptr) {
      e = sqrt_info_ * residual(T_world_from, T_world_to, T_from_to_, error_);
      return true;
    }
    const RelativePoseTerms terms = error_ == GraphError::kLog
                                        ? relative_pose_terms(T_world_from, T_world_to, T_from_to_)
                                        : quaternion_pose_terms(T_world_from, T_world_to, T_from_to_);
    e = sqrt_info_ * terms.residual;
    write(sqrt_info_ * terms.J_from, T_world_from.q, jacobians[0], jacobians[1]);
    write(sqrt_info_ * terms.J_to, T_world_to.q, jacobians[2], jacobians[3]);
    return true;
  }

 private:
  /// The columns of P = quaternion_by_rotation are orthonormal and the rotation is twice the tangent, so 2 J P^T is a
  /// derivative by the quaternion that its manifold projects back to the derivative by the rotation.
  static void write(const Mat6& J, const Quaternion& q, double* by_translation, double* by_quaternion) {
    if (by_translation != nullptr) Eigen::Map<RowMat63>{by_translation} = J.leftCols<3>();
    if (by_quaternion != nullptr) {
      Eigen::Map<RowMat64>{by_quaternion} = 2.0 * J.rightCols<3>() * quaternion_by_rotation(q).transpose();
    }
  }

  GraphError error_;
  SE3 T_from_to_;
  Mat6 sqrt_info_;
};

ceres::LossFunction* make_loss(const GraphSolverOptions& options) {
  const double scale = std::sqrt(options.loss_chi2);
  switch (options.loss) {
    case GraphLoss::kHuber:
      return new ceres::HuberLoss(scale);
    case GraphLoss::kCauchy:
      return new ceres::CauchyLoss(scale);
    case GraphLoss::kNone:
      break;
  }
  return nullptr;
}

void add_vertices(const std::vector<int>& fixed, std::vector<SE3>* vertices, ceres::Problem* problem) {
  for (SE3& T : *vertices) {
    problem->AddParameterBlock(T.t.data(), 3);
    problem->AddParameterBlock(T.q.coeffs().data(), 4);
    set_quaternion_manifold(*problem, T.q.coeffs().data());
  }
  for (const int v : fixed) {
    SE3& T = (*vertices)[static_cast<std::size_t>(v)];
    problem->SetParameterBlockConstant(T.t.data());
    problem->SetParameterBlockConstant(T.q.coeffs().data());
  }
}

bool all_finite(const std::vector<SE3>& vertices) {
  return std::all_of(vertices.begin(), vertices.end(), [](const SE3& T) { return T.is_finite(); });
}

/// @return the first fault that would make every residual meaningless, or an empty text
std::string fault(const std::vector<GraphEdge>& edges, const std::vector<int>& fixed,
                  const std::vector<SE3>& vertices) {
  if (vertices.empty()) return "no vertex";
  if (fixed.empty()) return "no vertex is fixed";
  if (!all_finite(vertices)) return "a vertex is not finite";
  const int n = static_cast<int>(vertices.size());
  if (std::any_of(fixed.begin(), fixed.end(), [n](int v) { return v < 0 || v >= n; }))
    return "a fixed vertex is unknown";
  for (const GraphEdge& edge : edges) {
    const bool is_joined = edge.from >= 0 && edge.to >= 0 && edge.from < n && edge.to < n && edge.from != edge.to;
    if (is_joined && edge.T_from_to.is_finite() && edge.sqrt_info.allFinite() && edge.weight >= 0.0) continue;
    return "edge " + std::to_string(edge.from) + " to " + std::to_string(edge.to) +
           " is not finite or joins no two vertices";
  }
  return {};
}

}  // namespace

ceres::Solver::Options ceres_options(const GraphSolverOptions& options) {
  ceres::Solver::Options result;
  result.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  result.num_threads = 1;
  // SuiteSparse starts threads of its own, to no use for a chain with some loops.
  if (!options.has_fill && ceres::IsSparseLinearAlgebraLibraryTypeAvailable(ceres::EIGEN_SPARSE)) {
    result.sparse_linear_algebra_library_type = ceres::EIGEN_SPARSE;
  }
  result.max_num_iterations = options.max_iterations;
  result.function_tolerance = options.function_tolerance;
  result.max_solver_time_in_seconds = 1e9;
  result.initial_trust_region_radius = 1e13;  // nearly Gauss-Newton: the start is good, or the solver backs off
  result.logging_type = ceres::SILENT;
  return result;
}

GraphSolution solve_graph(const std::vector<GraphEdge>& edges, const GraphSolverOptions& options,
                          std::vector<SE3>* T_world_vertex, const GraphObjects& objects) {
  GraphSolution solution;
  solution.message = fault(edges, options.fixed, *T_world_vertex);
  if (!solution.message.empty()) return solution;
  std::vector<SE3> vertices = *T_world_vertex;
  for (SE3& T : vertices) T.q.normalize();
  ceres::Problem problem;
  add_vertices(options.fixed, &vertices, &problem);
  for (const GraphEdge& edge : edges) {
    if (edge.weight <= 0.0) continue;
    SE3& from = vertices[static_cast<std::size_t>(edge.from)];
    SE3& to = vertices[static_cast<std::size_t>(edge.to)];
    problem.AddResidualBlock(new RelativePoseCost(edge, options.error), edge.robust ? make_loss(options) : nullptr,
                             from.t.data(), from.q.coeffs().data(), to.t.data(), to.q.coeffs().data());
  }
  const ObjectBlocks object_blocks(objects, &vertices, &problem);
  ceres::Solver::Summary summary;
  ceres::Solve(ceres_options(options), &problem, &summary);
  solution.initial_cost = summary.initial_cost;
  solution.final_cost = summary.final_cost;
  solution.iterations = static_cast<int>(summary.iterations.size());
  solution.usable = summary.IsSolutionUsable() && all_finite(vertices);
  solution.converged = summary.termination_type == ceres::CONVERGENCE;
  solution.message = summary.message;
  if (!solution.usable) return solution;
  for (SE3& T : vertices) T.q.normalize();
  for (const int v : options.fixed) {  // not even their rounding changes
    vertices[static_cast<std::size_t>(v)] = (*T_world_vertex)[static_cast<std::size_t>(v)];
  }
  *T_world_vertex = std::move(vertices);
  return solution;
}

double chi_squared(const GraphEdge& edge, const std::vector<SE3>& T_world_vertex, GraphError error) {
  const Vec6 e = residual(T_world_vertex[static_cast<std::size_t>(edge.from)],
                          T_world_vertex[static_cast<std::size_t>(edge.to)], edge.T_from_to, error);
  return (edge.sqrt_info * e).squaredNorm();
}

}  // namespace semantic_topo_loop::core
