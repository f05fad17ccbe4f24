#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <set>

#include "geometry/assignment.h"
#include "geometry/least_squares.h"

namespace semantic_topo_loop::core {
namespace {

double total(const Eigen::MatrixXd& score, const std::vector<int>& columns) {
  double sum = 0.0;
  for (int i = 0; i < score.rows(); ++i) {
    const int j = columns[static_cast<std::size_t>(i)];
    if (j >= 0) sum += score(i, j);
  }
  return sum;
}

/// Best total over every injective partial assignment.
double brute_force(const Eigen::MatrixXd& score, int row = 0, unsigned used = 0) {
  if (row == score.rows()) return 0.0;
  double best = brute_force(score, row + 1, used);
  for (int j = 0; j < score.cols(); ++j) {
    if ((used & (1u << j)) == 0 && score(row, j) > 0.0) {
      best = std::max(best, score(row, j) + brute_force(score, row + 1, used | (1u << j)));
    }
  }
  return best;
}

void expect_one_to_one(const Eigen::MatrixXd& score, const std::vector<int>& columns) {
  ASSERT_EQ(columns.size(), static_cast<std::size_t>(score.rows()));
  std::set<int> used;
  for (int i = 0; i < score.rows(); ++i) {
    const int j = columns[static_cast<std::size_t>(i)];
    if (j < 0) continue;
    ASSERT_LT(j, score.cols());
    EXPECT_GT(score(i, j), 0.0);
    EXPECT_TRUE(used.insert(j).second) << "column " << j << " taken twice";
  }
}

TEST(Assignment, PrefersTheTotalToTheGreedyChoice) {
  Eigen::MatrixXd score(2, 2);
  score << 0.9, 0.8, 0.8, 0.1;
  EXPECT_EQ(assign_max(score), (std::vector<int>{1, 0}));
}

TEST(Assignment, LeavesForbiddenPairsFree) {
  Eigen::MatrixXd score(3, 2);
  score << 0.0, -1.0, std::numeric_limits<double>::quiet_NaN(), 0.5, 0.4, std::numeric_limits<double>::infinity();
  EXPECT_EQ(assign_max(score), (std::vector<int>{-1, 1, 0}));
}

TEST(Assignment, EmptyInput) {
  EXPECT_TRUE(assign_max(Eigen::MatrixXd(0, 3)).empty());
  EXPECT_EQ(assign_max(Eigen::MatrixXd(2, 0)), (std::vector<int>{-1, -1}));
}

TEST(Assignment, MatchesBruteForceOnRandomMatrices) {
  std::mt19937_64 random(7);
  std::uniform_real_distribution<double> value(-0.5, 1.0);
  for (int trial = 0; trial < 600; ++trial) {
    Eigen::MatrixXd score(1 + static_cast<int>(random() % 6), 1 + static_cast<int>(random() % 6));
    for (int i = 0; i < score.size(); ++i) score.data()[i] = value(random);
    const std::vector<int> columns = assign_max(score);
    expect_one_to_one(score, columns);
    EXPECT_NEAR(total(score, columns), brute_force(score), 1e-12) << score;
  }
}

TEST(Assignment, MatchesBruteForceWithManyTies) {
  std::mt19937_64 random(8);
  for (int trial = 0; trial < 300; ++trial) {
    Eigen::MatrixXd score(1 + static_cast<int>(random() % 6), 1 + static_cast<int>(random() % 6));
    for (int i = 0; i < score.size(); ++i) score.data()[i] = static_cast<double>(random() % 3);
    const std::vector<int> columns = assign_max(score);
    expect_one_to_one(score, columns);
    EXPECT_EQ(total(score, columns), brute_force(score)) << score;
    EXPECT_EQ(columns, assign_max(score));
  }
}

TEST(Assignment, TransposedScoresGiveTheInverseAssignment) {
  std::mt19937_64 random(9);
  std::uniform_real_distribution<double> value(0.0, 1.0);
  Eigen::MatrixXd score(40, 70);
  for (int i = 0; i < score.size(); ++i) score.data()[i] = value(random);
  const std::vector<int> columns = assign_max(score);
  const std::vector<int> rows = assign_max(score.transpose());
  for (std::size_t i = 0; i < columns.size(); ++i) {
    ASSERT_GE(columns[i], 0);
    EXPECT_EQ(rows[static_cast<std::size_t>(columns[i])], static_cast<int>(i));
  }
}

/// Residuals a_i x + c_i y_k - m_i of two shared unknowns x and one of three blocks y_k of two: linear, so that steps
/// of hardly any damping solve it.
TEST(LeastSquares, EliminatesTheBlocks) {
  using Equations = ArrowEquations<2, 2>;
  using Unknowns = ArrowUnknowns<2, 2>;
  std::mt19937_64 random(4);
  std::normal_distribution<double> normal;
  Eigen::MatrixXd J = Eigen::MatrixXd::Zero(30, 8);
  Eigen::VectorXd m(30);
  for (int i = 0; i < 30; ++i) {
    J.row(i).head<2>() << normal(random), normal(random);
    J.row(i).segment<2>(2 + 2 * (i % 3)) << normal(random), normal(random);
    m(i) = normal(random);
  }
  const auto linearise = [&](const Unknowns& unknowns, Equations* equations) {
    *equations = Equations(3);
    for (int i = 0; i < 30; ++i) {
      const auto k = static_cast<std::size_t>(i % 3);
      const Eigen::RowVector2d a = J.row(i).head<2>(), c = J.row(i).segment<2>(2 + 2 * (i % 3));
      const double r = a.dot(unknowns.shared) + c.dot(unknowns.blocks[k]) - m(i);
      equations->cost += r * r;
      equations->H_shared += a.transpose() * a;
      equations->H_shared_block[k] += a.transpose() * c;
      equations->H_block[k] += c.transpose() * c;
      equations->g_shared += r * a.transpose();
      equations->g_block[k] += r * c.transpose();
    }
    return true;
  };
  Unknowns unknowns;
  unknowns.blocks.assign(3, Equations::VecB::Zero());
  Equations equations;
  ASSERT_TRUE(minimise({20, 1e-8, 1e-14}, linearise, &unknowns, &equations));
  const Eigen::MatrixXd H = J.transpose() * J;
  const Eigen::VectorXd solution = H.ldlt().solve(J.transpose() * m);
  EXPECT_LT((unknowns.shared - solution.head<2>()).norm(), 1e-6);
  for (int k = 0; k < 3; ++k) {
    EXPECT_LT((unknowns.blocks[static_cast<std::size_t>(k)] - solution.segment<2>(2 + 2 * k)).norm(), 1e-6);
  }
  const Eigen::Matrix2d covariance = equations.reduce(0.0, unknowns, nullptr).inverse();
  EXPECT_LT((covariance - H.inverse().topLeftCorner<2, 2>()).norm(), 1e-6);
}

/// Rosenbrock's valley, r = (10 (y - x^2), 1 - x), from the usual start.
TEST(LeastSquares, FollowsACurvedValleyAndRefusesWhatHasNoCost) {
  using Equations = ArrowEquations<2, 2>;
  using Unknowns = ArrowUnknowns<2, 2>;
  const auto linearise = [](const Unknowns& unknowns, Equations* equations) {
    const double x = unknowns.shared(0), y = unknowns.shared(1);
    const Eigen::Vector2d r(10.0 * (y - x * x), 1.0 - x);
    Eigen::Matrix2d J;
    J << -20.0 * x, 10.0, -1.0, 0.0;
    equations->H_shared = J.transpose() * J;
    equations->g_shared = J.transpose() * r;
    equations->cost = r.squaredNorm();
    return std::isfinite(equations->cost);
  };
  Unknowns unknowns;
  unknowns.shared << -1.2, 1.0;
  Equations equations;
  ASSERT_TRUE(minimise({100, 1e-3, 1e-12}, linearise, &unknowns, &equations));
  EXPECT_LT((unknowns.shared - Eigen::Vector2d::Ones()).norm(), 1e-4);
  unknowns.shared(0) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(minimise({100, 1e-3, 1e-12}, linearise, &unknowns, &equations));
}

}  // namespace
}  // namespace semantic_topo_loop::core
