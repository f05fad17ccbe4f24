#include "pose_graph/scale/similarity_solver.h"

#include <algorithm>
#include <cmath>

#include "geometry/ceres_compat.h"
#include "pose_graph/scale/relative_similarity.h"
#include "pose_graph/solver/graph_problem.h"
#include "semantic_topo_loop/geometry/lie.h"

namespace semantic_topo_loop::core {
namespace {

using RowMat73 = Eigen::Matrix<double, 7, 3, Eigen::RowMajor>;
using RowMat74 = Eigen::Matrix<double, 7, 4, Eigen::RowMajor>;

/// A vertex as Ceres holds it.
struct Vertex {
  Vec3 t;
  Quaternion q;
  double log_scale;

  explicit Vertex(const Sim3& S) : t(S.T.t), q(S.T.q.normalized()), log_scale(std::log(S.scale)) {}
  Sim3 similarity() const { return Sim3(SE3(q.normalized(), t), std::exp(log_scale)); }
};

Sim3 similarity(const double* t, const double* q, const double* log_scale) {
  return Sim3(SE3(Quaternion(q), Vec3(t)), std::exp(*log_scale));
}

/// sqrt(w) U e over (t, q, log scale) of from and to.
class RelativeSimilarityCost : public ceres::SizedCostFunction<7, 3, 4, 1, 3, 4, 1> {
 public:
  explicit RelativeSimilarityCost(const SimilarityEdge& edge)
      : S_from_to_(edge.S_from_to), sqrt_info_(std::sqrt(edge.weight) * edge.sqrt_info) {}

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const Sim3 S_world_from = similarity(parameters[0], parameters[1], parameters[2]);
    const Sim3 S_world_to = similarity(parameters[3], parameters[4], parameters[5]);
    Eigen::Map<Vec7> e(residuals);
    if (jacobians == nullptr) {
      e = sqrt_info_ * relative_similarity_residual(S_world_from, S_world_to, S_from_to_);
      return true;
    }
    const RelativeSimilarityTerms terms = relative_similarity_terms(S_world_from, S_world_to, S_from_to_);
    e = sqrt_info_ * terms.residual;
    write(sqrt_info_ * terms.J_from, S_world_from.T.q, jacobians);
    write(sqrt_info_ * terms.J_to, S_world_to.T.q, jacobians + 3);
    return true;
  }

 private:
  /// See RelativePoseCost for the derivative by the quaternion.
  static void write(const Mat7& J, const Quaternion& q, double** jacobians) {
    if (jacobians[0] != nullptr) Eigen::Map<RowMat73>{jacobians[0]} = J.leftCols<3>();
    if (jacobians[1] != nullptr) {
      Eigen::Map<RowMat74>{jacobians[1]} = 2.0 * J.middleCols<3>(3) * quaternion_by_rotation(q).transpose();
    }
    if (jacobians[2] != nullptr) Eigen::Map<Vec7>{jacobians[2]} = J.col(6);
  }

  Sim3 S_from_to_;
  Mat7 sqrt_info_;
};

bool all_finite(const std::vector<Sim3>& vertices) {
  return std::all_of(vertices.begin(), vertices.end(), [](const Sim3& S) { return S.is_finite(); });
}

/// @return the first fault that would make every residual meaningless, or an empty text
std::string fault(const std::vector<SimilarityEdge>& edges, const std::vector<int>& fixed,
                  const std::vector<Sim3>& vertices) {
  const int n = static_cast<int>(vertices.size());
  const auto is_known = [n](int v) { return v >= 0 && v < n; };
  if (vertices.empty()) return "no vertex";
  if (fixed.empty() || !std::all_of(fixed.begin(), fixed.end(), is_known)) return "no known vertex is fixed";
  if (!all_finite(vertices)) return "a vertex is not finite";
  for (const SimilarityEdge& edge : edges) {
    const bool is_joined = is_known(edge.from) && is_known(edge.to) && edge.from != edge.to;
    if (is_joined && edge.S_from_to.is_finite() && edge.sqrt_info.allFinite() && edge.weight >= 0.0) continue;
    return "edge " + std::to_string(edge.from) + " to " + std::to_string(edge.to) +
           " is not finite or joins no two vertices";
  }
  return {};
}

void add_vertices(const std::vector<int>& fixed, std::vector<Vertex>* vertices, ceres::Problem* problem) {
  for (Vertex& vertex : *vertices) {
    problem->AddParameterBlock(vertex.t.data(), 3);
    problem->AddParameterBlock(vertex.q.coeffs().data(), 4);
    set_quaternion_manifold(*problem, vertex.q.coeffs().data());
    problem->AddParameterBlock(&vertex.log_scale, 1);
  }
  for (const int v : fixed) {
    Vertex& vertex = (*vertices)[static_cast<std::size_t>(v)];
    problem->SetParameterBlockConstant(vertex.t.data());
    problem->SetParameterBlockConstant(vertex.q.coeffs().data());
    problem->SetParameterBlockConstant(&vertex.log_scale);
  }
}

}  // namespace

GraphSolution solve_similarity_graph(const std::vector<SimilarityEdge>& edges, const GraphSolverOptions& options,
                                     std::vector<Sim3>* S_world_vertex) {
  GraphSolution solution;
  solution.message = fault(edges, options.fixed, *S_world_vertex);
  if (!solution.message.empty()) return solution;
  std::vector<Vertex> vertices(S_world_vertex->begin(), S_world_vertex->end());
  ceres::Problem problem;
  add_vertices(options.fixed, &vertices, &problem);
  for (const SimilarityEdge& edge : edges) {
    if (edge.weight <= 0.0) continue;
    Vertex& from = vertices[static_cast<std::size_t>(edge.from)];
    Vertex& to = vertices[static_cast<std::size_t>(edge.to)];
    problem.AddResidualBlock(new RelativeSimilarityCost(edge), nullptr, from.t.data(), from.q.coeffs().data(),
                             &from.log_scale, to.t.data(), to.q.coeffs().data(), &to.log_scale);
  }
  ceres::Solver::Summary summary;
  ceres::Solve(ceres_options(options), &problem, &summary);
  solution.initial_cost = summary.initial_cost;
  solution.final_cost = summary.final_cost;
  solution.iterations = static_cast<int>(summary.iterations.size());
  solution.converged = summary.termination_type == ceres::CONVERGENCE;
  solution.message = summary.message;
  std::vector<Sim3> result;
  for (const Vertex& vertex : vertices) result.push_back(vertex.similarity());
  solution.usable = summary.IsSolutionUsable() && all_finite(result);
  if (!solution.usable) return solution;
  for (const int v : options.fixed) {  // not even their rounding changes
    result[static_cast<std::size_t>(v)] = (*S_world_vertex)[static_cast<std::size_t>(v)];
  }
  *S_world_vertex = std::move(result);
  return solution;
}

}  // namespace semantic_topo_loop::core
