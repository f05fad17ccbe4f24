#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <cstddef>
#include <utility>
#include <vector>

namespace semantic_topo_loop::core {

/// The unknowns of a problem whose blocks do not meet each other, such as a pose and the objects that it sees.
template <int kShared, int kBlock>
struct ArrowUnknowns {
  Eigen::Matrix<double, kShared, 1> shared = Eigen::Matrix<double, kShared, 1>::Zero();
  std::vector<Eigen::Matrix<double, kBlock, 1>> blocks;

  bool is_finite() const { return shared.allFinite(); }
};

/// Its normal equations H step = -g; residuals add J^T w J to H and J^T w r to g.
template <int kShared, int kBlock>
struct ArrowEquations {
  using Unknowns = ArrowUnknowns<kShared, kBlock>;
  using MatS = Eigen::Matrix<double, kShared, kShared>;
  using VecS = Eigen::Matrix<double, kShared, 1>;
  using MatSB = Eigen::Matrix<double, kShared, kBlock>;
  using MatB = Eigen::Matrix<double, kBlock, kBlock>;
  using VecB = Eigen::Matrix<double, kBlock, 1>;

  /// Added to the diagonal of each block, in its unit: a block that nothing measures stays where it is.
  static constexpr double kMinInformation = 1e-6;

  explicit ArrowEquations(std::size_t blocks = 0)
      : H_shared_block(blocks, MatSB::Zero()), H_block(blocks, MatB::Zero()), g_block(blocks, VecB::Zero()) {}

  MatS H_shared = MatS::Zero();
  VecS g_shared = VecS::Zero();
  std::vector<MatSB> H_shared_block;
  std::vector<MatB> H_block;
  std::vector<VecB> g_block;
  double cost = 0.0;

  /// Eliminates the blocks (Schur complement).
  /// @param damping factor by which the diagonals grow   @param next null, or where the step from `unknowns` leads
  /// @return information of the shared unknowns
  MatS reduce(double damping, const Unknowns& unknowns, Unknowns* next) const {
    MatS S = H_shared;
    S.diagonal() *= 1.0 + damping;
    VecS b = g_shared;
    std::vector<Eigen::LDLT<MatB>> factors;
    for (std::size_t k = 0; k < H_block.size(); ++k) {
      MatB H = H_block[k];
      H.diagonal() *= 1.0 + damping;
      H.diagonal().array() += kMinInformation;
      factors.emplace_back(H);
      S -= H_shared_block[k] * factors.back().solve(H_shared_block[k].transpose());
      b -= H_shared_block[k] * factors.back().solve(g_block[k]);
    }
    if (next == nullptr) return S;
    const VecS step = -S.ldlt().solve(b);
    *next = unknowns;
    next->shared += step;
    for (std::size_t k = 0; k < H_block.size(); ++k) {
      next->blocks[k] -= factors[k].solve(g_block[k] + H_shared_block[k].transpose() * step);
    }
    return S;
  }
};

struct LeastSquaresOptions {
  int max_iterations = 15;
  double damping = 1e-4;  ///< at the start; a tenth of it after a step that helps, ten times it after one that does not
  double min_decrease = 1e-6;  ///< of the cost, relative; less ends the iteration
};

/// Levenberg-Marquardt for a handful of shared unknowns and blocks of a few, for which Ceres' set-up costs more than
/// the solution.
/// @tparam Equations ArrowEquations, or the like: with Unknowns, cost and reduce()
/// @param linearise bool(unknowns, equations*): overwrites the equations; false where the cost is not defined
/// @param unknowns the start, then the best found   @param equations there, overwritten   @param spare overwritten too
/// @return false if the start has no cost or a step is not finite
template <class Equations, class Linearise>
bool minimise(const LeastSquaresOptions& options, const Linearise& linearise, typename Equations::Unknowns* unknowns,
              Equations* equations, Equations* spare) {
  constexpr double kMaxDamping = 1e6;  // steps are a millionth of the gradient's then: nothing is to be gained
  if (!linearise(*unknowns, equations)) return false;
  double damping = options.damping;
  for (int i = 0; i < options.max_iterations && damping < kMaxDamping; ++i) {
    typename Equations::Unknowns next;
    equations->reduce(damping, *unknowns, &next);
    if (!next.is_finite()) return false;
    const bool better = linearise(next, spare) && spare->cost < equations->cost;
    damping *= better ? 0.1 : 10.0;
    if (!better) continue;
    const bool settled = equations->cost - spare->cost < options.min_decrease * equations->cost;
    *unknowns = std::move(next);
    std::swap(*equations, *spare);
    if (settled) break;
  }
  return true;
}

template <class Equations, class Linearise>
bool minimise(const LeastSquaresOptions& options, const Linearise& linearise, typename Equations::Unknowns* unknowns,
              Equations* equations) {
  Equations spare;
  return minimise(options, linearise, unknowns, equations, &spare);
}

}  // namespace semantic_topo_loop::core
