#include <Eigen/SVD>
#include <Eigen/SparseCholesky>
#include <deque>

#include "tools/g2o/g2o.h"

namespace semantic_topo_loop::core {
namespace {

using SparseMatrix = Eigen::SparseMatrix<double>;
using Triplets = std::vector<Eigen::Triplet<double>>;
using Mat3X = Eigen::Matrix<double, Eigen::Dynamic, 3>;

std::size_t index(int vertex) { return static_cast<std::size_t>(vertex); }

/// Poses along the fewest edges from those that are placed already.
void grow(const std::vector<GraphEdge>& edges, std::vector<bool> placed, std::vector<SE3>* poses) {
  std::vector<std::vector<std::size_t>> edges_of(poses->size());
  for (std::size_t i = 0; i < edges.size(); ++i) {
    edges_of[index(edges[i].from)].push_back(i);
    edges_of[index(edges[i].to)].push_back(i);
  }
  std::deque<std::size_t> queue;
  for (std::size_t v = 0; v < placed.size(); ++v) {
    if (placed[v]) queue.push_back(v);
  }
  for (; !queue.empty(); queue.pop_front()) {
    const std::size_t v = queue.front();
    for (const std::size_t i : edges_of[v]) {
      const GraphEdge& edge = edges[i];
      const bool forward = index(edge.from) == v;
      const std::size_t next = index(forward ? edge.to : edge.from);
      if (placed[next]) continue;
      placed[next] = true;
      (*poses)[next] = (*poses)[v] * (forward ? edge.T_from_to : edge.T_from_to.inverse());
      queue.push_back(next);
    }
  }
}

Mat3 nearest_rotation(const Mat3& m) {
  const Eigen::JacobiSVD<Mat3> svd(m, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Vec3 signs = Vec3::Ones();
  signs(2) = (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0.0 ? -1.0 : 1.0;
  return svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
}

/// Normal equations of x_to - A^T x_from = b over blocks of `size` rows per vertex; the first vertex is known.
class BlockSystem {
 public:
  BlockSystem(std::size_t vertices, Eigen::Index size)
      : size_(size), right_(Mat3X::Zero(static_cast<Eigen::Index>(vertices - 1) * size, 3)) {}

  /// @param known value of the first vertex
  void add(const GraphEdge& edge, double weight, const Eigen::MatrixXd& A, const Mat3X& b, const Mat3X& known) {
    const Eigen::MatrixXd identity = Eigen::MatrixXd::Identity(size_, size_);
    const Eigen::MatrixXd from = -A.transpose();
    if (edge.from == 0) {
      accumulate(edge.to, identity, weight, b - from * known);
    } else if (edge.to == 0) {
      accumulate(edge.from, from, weight, b - known);
    } else {
      accumulate(edge.to, identity, weight, b);
      accumulate(edge.from, from, weight, b);
      add_block(edge.to, edge.from, weight * from);
      add_block(edge.from, edge.to, weight * from.transpose());
    }
  }

  /// @return whether there is a solution
  bool solve(Mat3X* x) const {
    SparseMatrix left(right_.rows(), right_.rows());
    left.setFromTriplets(left_.begin(), left_.end());
    const Eigen::SimplicialLDLT<SparseMatrix> solver(left);
    if (solver.info() != Eigen::Success) return false;
    *x = solver.solve(right_);
    return solver.info() == Eigen::Success && x->allFinite();
  }

 private:
  Eigen::Index row(int vertex) const { return static_cast<Eigen::Index>(vertex - 1) * size_; }

  void accumulate(int vertex, const Eigen::MatrixXd& J, double weight, const Mat3X& b) {
    add_block(vertex, vertex, weight * J.transpose() * J);
    right_.middleRows(row(vertex), size_) += weight * J.transpose() * b;
  }
  void add_block(int i, int j, const Eigen::MatrixXd& block) {
    for (Eigen::Index r = 0; r < size_; ++r) {
      for (Eigen::Index c = 0; c < size_; ++c) {
        left_.emplace_back(static_cast<int>(row(i) + r), static_cast<int>(row(j) + c), block(r, c));
      }
    }
  }

  Eigen::Index size_;
  Mat3X right_;
  Triplets left_;
};

double mean_information(const GraphEdge& edge, int first) {
  const Mat6 information = edge.sqrt_info.transpose() * edge.sqrt_info;
  return edge.weight * information.diagonal().segment<3>(first).mean();
}

/// R_to = R_from R_from_to, by rows of R transposed: R_to^T - R_from_to^T R_from^T = 0.
bool chordal_rotations(const std::vector<GraphEdge>& edges, std::vector<SE3>* poses) {
  BlockSystem system(poses->size(), 3);
  const Mat3X known = poses->front().rotation().transpose();
  for (const GraphEdge& edge : edges) {
    system.add(edge, mean_information(edge, 3), edge.T_from_to.rotation(), Mat3X::Zero(3, 3), known);
  }
  Mat3X x;
  if (!system.solve(&x)) return false;
  for (std::size_t v = 1; v < poses->size(); ++v) {
    const Mat3 transposed = x.middleRows<3>(3 * static_cast<Eigen::Index>(v - 1));
    (*poses)[v].q = Quaternion(nearest_rotation(transposed.transpose()));
  }
  return true;
}

bool linear_positions(const std::vector<GraphEdge>& edges, std::vector<SE3>* poses) {
  BlockSystem system(poses->size(), 1);
  const Eigen::MatrixXd one = Eigen::MatrixXd::Identity(1, 1);
  const Mat3X known = poses->front().t.transpose();
  for (const GraphEdge& edge : edges) {
    const Mat3X step = ((*poses)[index(edge.from)].q * edge.T_from_to.t).transpose();
    system.add(edge, mean_information(edge, 0), one, step, known);
  }
  Mat3X x;
  if (!system.solve(&x)) return false;
  for (std::size_t v = 1; v < poses->size(); ++v) (*poses)[v].t = x.row(static_cast<Eigen::Index>(v - 1));
  return true;
}

}  // namespace

std::vector<SE3> first_guess(const std::string& kind, const std::vector<GraphEdge>& edges,
                             const std::vector<SE3>& T_world_vertex) {
  std::vector<SE3> poses = T_world_vertex;
  std::vector<bool> placed(poses.size(), false);
  if (!placed.empty()) placed.front() = true;
  if (kind == "odometry") {
    std::vector<const GraphEdge*> steps(poses.size(), nullptr);  // to each vertex from the one before
    for (const GraphEdge& edge : edges) {
      if (edge.to == edge.from + 1 && steps[index(edge.to)] == nullptr) steps[index(edge.to)] = &edge;
    }
    for (std::size_t v = 1; v < poses.size() && steps[v] != nullptr; ++v) {
      poses[v] = poses[v - 1] * steps[v]->T_from_to;
      placed[v] = true;
    }
  }
  grow(edges, std::move(placed), &poses);
  if (kind != "chordal" || poses.size() < 2) return poses;
  std::vector<SE3> chordal = poses;
  return chordal_rotations(edges, &chordal) && linear_positions(edges, &chordal) ? chordal : poses;
}

}  // namespace semantic_topo_loop::core
